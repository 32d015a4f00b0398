"""The engine's options of a race: plain values, already checked."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Annotated

from stkzoo._schema import Matching, OneOf, Share, Within
from stkzoo.config import Start
from stkzoo.names import CameraMode

_FOLDER = Matching(r"[^/\\\0]*", "the name of a folder in the game's data")


@dataclass(frozen=True, slots=True)
class KartSetup:
    """One kart, at its place on the starting grid.

    Attributes:
        is_bot: the game's own AI drives.
        reports_control: the snapshots carry what the game's AI chose for this kart.
        kart: model name; empty for the game's default.
        name: the player's name.
        color: hue shift in [0, 1]; 0 leaves the model's colours.
        camera_mode: number of :class:`stkzoo.names.CameraMode`.
    """

    is_bot: bool = True
    reports_control: bool = False
    kart: Annotated[str, _FOLDER] = ""
    name: str = ""
    color: Share = 0.0
    camera_mode: Annotated[int, OneOf(tuple(map(int, CameraMode)))] = 0


@dataclass(frozen=True, slots=True)
class RaceSetup:
    """One race. ``karts`` is in grid order, first place first.

    ``starts`` says where each kart starts; by default all start on the grid.
    """

    track: Annotated[str, _FOLDER]
    karts: Annotated[tuple[KartSetup, ...], Within(1, 256)]
    laps: int = 1
    reverse: bool = False
    difficulty: int = 2
    seed: int = 0
    step_size: float = 0.1
    num_cameras: Annotated[int, Within(0, 8)] = 0
    starts: tuple[Start, ...] = ()

    def to_json(self) -> bytes:
        """The setup as UTF-8 JSON."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, data: bytes) -> RaceSetup:
        """Reads what :meth:`to_json` wrote."""
        values = json.loads(data)
        karts = tuple(KartSetup(**kart) for kart in values.pop("karts"))
        starts = tuple(Start(**start) for start in values.pop("starts", ()))
        return cls(karts=karts, starts=starts, **values)
