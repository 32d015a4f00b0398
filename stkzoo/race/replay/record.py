"""What a replay consists of."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.race.result import RaceResult

__all__ = ["DIGEST_SIZE", "Replay", "ReplayAgent", "action_of", "controls_of", "next_digest"]

#: Bytes of one digest.
DIGEST_SIZE = 8

_BUTTONS = CONTROLS[2:]


@dataclass(frozen=True, slots=True)
class ReplayAgent:
    """One agent of a recorded race.

    Attributes:
        name: the name to show.
        source: where its driver came from.
        is_game_ai: whether the game drove it.
    """

    name: str
    source: str
    is_game_ai: bool


@dataclass(frozen=True, slots=True)
class Replay:
    """A recorded race.

    Attributes:
        track: its name.
        reverse: whether it was driven the other way round.
        laps: laps to drive.
        difficulty: level of the game's AI, 0 to 3.
        max_paths: how many track segments ahead were observed; ``None`` is all.
        step_size: game time of a step [s].
        seed: what the environment was reset with.
        num_tracks: how many tracks ``track`` was drawn from: it is a part of the seed's
            stream of random numbers.
        engine_seed: what came out of it for the engine.
        start_positions: every agent's place on the grid, 1 is in front.
        kart_types: model of each kart, in grid order.
        agents: who drove, in agent order.
        controls: ``(T, A, 7)`` float32: what each agent did in each step, with the columns of
            :data:`~stkzoo.engine.snapshot.CONTROLS`; zeros for those whom the game drives
            and those who have finished.
        digests: ``(T + 1, 8)`` uint8: the chain of :func:`next_digest`, from the grid on.
        status: why the race was over; ``"partial"`` if it ended by an error.
        result: how it ended; ``None`` if it ended by an error.
        versions: of the software that ran it.
    """

    track: str
    reverse: bool
    laps: int
    difficulty: int
    max_paths: int | None
    step_size: float
    seed: int
    num_tracks: int
    engine_seed: int
    start_positions: tuple[int, ...]
    kart_types: tuple[str, ...]
    agents: tuple[ReplayAgent, ...]
    controls: npt.NDArray[np.float32] = field(repr=False)
    digests: npt.NDArray[np.uint8] = field(repr=False)
    status: str
    result: RaceResult | None = field(repr=False)
    versions: Mapping[str, str]

    @property
    def steps(self) -> int:
        """Steps recorded."""
        return len(self.controls)

    @property
    def is_partial(self) -> bool:
        """Whether the race was cut off, by an interrupt or an error."""
        return self.result is None or self.status == "interrupted"


def next_digest(digest: bytes, snapshot: Snapshot) -> bytes:
    """One more link of the chain: it depends on where all karts are now and ever were.

    It is BLAKE2b (8 bytes) of the link before (nothing for the first) and of all karts'
    locations ``(K, 3)``, rotations ``(K, 4)`` and velocities ``(K, 3)``, as little-endian
    float32, karts in grid order.
    """
    link = hashlib.blake2b(digest, digest_size=DIGEST_SIZE)
    for name in ("location", "rotation", "velocity"):
        link.update(np.ascontiguousarray(snapshot.karts[name], "<f4").tobytes())
    return link.digest()


def controls_of(action: Mapping[str, Any]) -> list[float]:
    """An action in the game's own form as a row of controls."""
    return [float(np.asarray(action[name]).reshape(())) for name in CONTROLS]


def action_of(row: npt.NDArray[np.float32]) -> dict[str, Any]:
    """The action that :func:`controls_of` made a row of."""
    action: dict[str, Any] = {
        name: row[column : column + 1] for column, name in enumerate(CONTROLS[:2])
    }
    return action | {name: int(row[column]) for column, name in enumerate(_BUTTONS, 2)}
