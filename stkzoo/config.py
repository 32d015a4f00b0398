"""Options of an agent and of its start, as users write them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from stkzoo.errors import ConfigError, check_arguments, check_number, unknown_name
from stkzoo.names import CameraMode

__all__ = ["AgentSpec", "RandomStart", "Start", "start_of"]

#: Top speed of karts without nitro and bonuses [m/s].
_MAX_START_SPEED = 25.0


@check_arguments
@dataclass
class AgentSpec:
    """One agent of a race. Fields may be set after construction, until the next reset.

    Attributes:
        rank_start: place on the starting grid, 0 in front; ``None`` draws a free one
            at every reset.
        use_ai: the game's own AI drives; the agent's actions are ignored and its
            observation carries the AI's choice under ``action``.
        name: the player's name.
        camera_mode: whether the kart has a camera when the game draws itself; also by name,
            such as ``"ON"``.
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

    @classmethod
    def of(cls, value: AgentSpec | Mapping[str, object], name: str = "agent") -> AgentSpec:
        """The spec, or that of a mapping of its fields, as JSON and YAML have them.

        Args:
            value: a spec, which is returned as it is, or a mapping; its ``camera_mode`` may be a
                number.
            name: what the value is for, such as ``"agent 0"``.

        Raises:
            ConfigError: it is neither, or a field is unknown.
        """
        if isinstance(value, AgentSpec):
            return value
        if not isinstance(value, Mapping):
            raise ConfigError(
                f"{name} is {value!r}, expected an AgentSpec or a mapping of its fields"
            )
        known = [field.name for field in fields(cls)]
        for field in value:
            if field not in known:
                raise unknown_name(f"field of {name}", field, known)
        mode = value.get("camera_mode")
        if isinstance(mode, int) and mode in list(CameraMode):
            value = {**value, "camera_mode": CameraMode(mode)}
        return cls(**value)  # type: ignore[arg-type]


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """A place on the track to start from, and how fast.

    Attributes:
        distance: along the centre line from the start line on [m]; below 0 is before it.
        share: the same as a share of the lap, from 0 up to 1; give one of both.
        offset: to the right of the centre line [m].
        heading: to the right of the road's direction [rad].
        speed: forwards [m/s].
        behind: distance before that place [m].

    Raises:
        ConfigError: a number is out of range.
    """

    distance: float | None = None
    share: float | None = None
    offset: float = 0.0
    heading: float = 0.0
    speed: float = 0.0
    behind: float = 0.0

    def __post_init__(self) -> None:
        if (self.distance is None) == (self.share is None):
            raise ConfigError(f"{self!r} needs either a distance [m] or a share of the lap")
        if self.share is not None:
            check_number("share of a start", self.share, 0.0, 1.0)
        else:
            check_number("distance of a start", self.distance, -1e3, 1e5)
        check_number("offset of a start", self.offset, -100.0, 100.0)
        check_number("heading of a start", self.heading, -math.pi, math.pi)
        check_number("speed of a start", self.speed, 0.0, _MAX_START_SPEED)
        check_number("behind of a start", self.behind, 0.0, 2e3)


@check_arguments
@dataclass(frozen=True, slots=True, kw_only=True)
class RandomStart:
    """Starts drawn at every reset, each number uniformly between two bounds.

    Attributes:
        share: where, as a share of the lap, from 0 up to 1.
        offset: to the right of the centre line [m].
        heading: to the right of the road's direction [rad].
        speed: forwards [m/s].

    Raises:
        ConfigError: bounds are invalid.
    """

    share: tuple[float, float] = (0.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    heading: tuple[float, float] = (0.0, 0.0)
    speed: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for field in fields(self):
            bounds = getattr(self, field.name)
            if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
                raise ConfigError(f"{field.name} is {bounds!r}, expected (lowest, highest)")
            low, high = (Start(**{"share": 0.0, field.name: bound}) for bound in bounds)
            if getattr(low, field.name) > getattr(high, field.name):
                raise ConfigError(f"{field.name} is {bounds!r}, expected (lowest, highest)")


def start_of(values: Mapping[str, object]) -> Start | RandomStart:
    """The start of a mapping of its fields, as JSON and YAML have them.

    Args:
        values: fields of a :class:`Start`; with pairs, those of a :class:`RandomStart`.

    Raises:
        ConfigError: a field is unknown or its value invalid.
    """
    pairs = {name: tuple(pair) for name, pair in values.items() if isinstance(pair, (tuple, list))}
    kind: Any = RandomStart if pairs else Start
    known = [field.name for field in fields(kind)]
    for name in values:
        if name not in known:
            raise unknown_name("field of a start", name, known)
    start: Start | RandomStart = kind(**{**values, **pairs})
    return start
