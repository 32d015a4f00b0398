"""The engine's options for a race: plain values that have already been checked."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from stkzoo._left_out import LeftOutNames
from stkzoo._schema import Share, matching, one_of
from stkzoo.config import NORMAL, RACE_MODES, Start
from stkzoo.names import CameraMode

#: Maximum number of karts with a camera; the game can split its screen into so many parts.
MAX_CAMERAS = 8

#: Team of a kart without a team, and maximum number of a team.
NO_TEAM, MAX_TEAMS = -1, 255

_FOLDER = matching(r"[^/\\\0]*")


@dataclass(frozen=True, slots=True)
class KartSetup(LeftOutNames):
    """The engine's options for one kart.

    Attributes:
        is_bot: whether the game's AI drives the kart.
        reports_control: whether snapshots include the controls of the game's AI for this kart.
        kart: model name; empty for the game's default.
        name: name of the player.
        color: hue shift in [0, 1]; 0 keeps the model's colors.
        camera_mode: number of :class:`stkzoo.names.CameraMode`.
        team: number of the kart's team; -1 for none. The engine does not use it.
    """

    left_out: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("Controller", "controller"), "use is_bot"),
        "CameraMode": "use stkzoo.CameraMode",
    }
    is_bot: bool = True
    reports_control: bool = False
    kart: Annotated[str, _FOLDER] = ""
    name: str = ""
    color: Share = 0.0
    camera_mode: Annotated[int, Meta(ge=0, le=int(max(CameraMode)))] = 0
    team: Annotated[int, Meta(ge=-1, le=MAX_TEAMS)] = NO_TEAM


@dataclass(frozen=True, slots=True)
class RaceSetup(LeftOutNames):
    """The engine's options for one race.

    Attributes:
        track: name of the track.
        karts: the karts in grid order, first place first.
        laps: number of laps.
        reverse: whether karts drive the track in reverse.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        seed: seed of the engine.
        step_size: game time of one step [s].
        num_cameras: number of karts with a camera; the renderer uses it, the engine does not.
        starts: start of each kart; if empty, all karts start on the grid.
        mode: mode of the race, one of :data:`stkzoo.config.RACE_MODES`.
    """

    left_out: ClassVar[dict[str, str]] = dict.fromkeys(
        ("RaceMode", "overlay"), "use mode and a render_mode"
    )
    track: Annotated[str, _FOLDER]
    karts: Annotated[tuple[KartSetup, ...], Meta(min_length=1, max_length=256)]
    laps: int = 1
    reverse: bool = False
    difficulty: int = 2
    seed: int = 0
    step_size: float = 0.1
    num_cameras: Annotated[int, Meta(ge=0, le=MAX_CAMERAS)] = 0
    starts: tuple[Start, ...] = ()
    mode: Annotated[str, one_of(*RACE_MODES)] = NORMAL

    @property
    def players(self) -> tuple[KartSetup, ...]:
        """The karts, under pystk2's name."""
        return self.karts

    @property
    def num_kart(self) -> int:
        """Number of karts."""
        return len(self.karts)

    def to_json(self) -> bytes:
        """Returns the setup as UTF-8 JSON."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, data: bytes) -> RaceSetup:
        """Decodes the JSON of :meth:`to_json`."""
        values = json.loads(data)
        karts = tuple(KartSetup(**kart) for kart in values.pop("karts"))
        starts = tuple(Start(**start) for start in values.pop("starts", ()))
        return cls(karts=karts, starts=starts, **values)
