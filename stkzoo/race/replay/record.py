"""The content of a replay."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.race.result import RaceResult

#: Bytes of one digest.
DIGEST_SIZE = 8

_BUTTONS = CONTROLS[2:]


@dataclass(frozen=True, slots=True)
class ReplayAgent:
    """One agent of a recorded race.

    Attributes:
        name: the name to show.
        source: the driver's source.
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
        reverse: whether it was driven in the other direction.
        laps: laps to drive.
        difficulty: level of the game's AI, 0 to 3.
        max_paths: track segments ahead in observations; ``None`` for all.
        step_size: game time of a step [s].
        seed: seed of the environment's reset.
        num_tracks: number of tracks that ``track`` was drawn from, which affects the random
            numbers after it.
        engine_seed: the engine's seed, drawn with ``seed``.
        start_positions: every agent's place on the grid, 1 is in front.
        kart_types: model of each kart, in grid order.
        agents: the drivers, in agent order.
        controls: ``(T, A, 7)`` float32: each agent's controls in each step, with the columns of
            :data:`~stkzoo.engine.snapshot.CONTROLS`; zeros for agents that the game drives or
            that have finished.
        digests: ``(T + 1, 8)`` uint8: the chain of :func:`next_digest`, from the grid on.
        status: the result's status; ``"partial"`` if the race ended with an error.
        result: the race's result; ``None`` if it ended with an error.
        versions: versions of the software.
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
        """Whether an interrupt or an error ended the race."""
        return self.result is None or self.status == "interrupted"


def next_digest(digest: bytes, snapshot: Snapshot) -> bytes:
    """The next link of a hash chain, which depends on the positions of all karts so far.

    It is BLAKE2b (8 bytes) of the previous link (nothing for the first) and of all karts'
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
    """The inverse of :func:`controls_of`."""
    action: dict[str, Any] = {
        name: row[column : column + 1] for column, name in enumerate(CONTROLS[:2])
    }
    return action | {name: int(row[column]) for column, name in enumerate(_BUTTONS, 2)}
