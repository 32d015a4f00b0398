"""What a user chooses about a race and its agents."""

from __future__ import annotations

from dataclasses import dataclass

from stkzoo.names import CameraMode

__all__ = ["AgentSpec"]


@dataclass
class AgentSpec:
    """One agent of a race. Fields may be set after construction, until the next reset.

    Attributes:
        rank_start: place on the starting grid, 0 in front; ``None`` draws a free one
            at every reset.
        use_ai: the game's own AI drives; the agent's actions are ignored and its
            observation carries the AI's choice under ``action``.
        name: the player's name.
        camera_mode: whether the kart has a camera when the game draws itself.
        kart: kart model, such as ``"gnu"`` (``stkzoo assets status`` lists them);
            empty for the game's default.
        color: hue shift in [0, 1]; 0 leaves the kart as it is.
    """

    rank_start: int | None = None
    use_ai: bool = False
    name: str = ""
    camera_mode: CameraMode = CameraMode.AUTO
    kart: str = ""
    color: float = 0.0
