"""The oracle of ``agents/planning/memory.c`` in NumPy, which documents the arguments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.memory import PlanMemory

FloatArray = npt.NDArray[np.float32]

_NAMES = PlanMemory._fields
#: Rows of the countdowns, which are contiguous.
_CLOCKS = slice(_NAMES.index("hold_steps"), _NAMES.index("rescue_steps") + 1)


class _MemoryRules(NamedTuple):
    """Thresholds and times. Times are in steps, except where noted."""

    step: float  # [s]
    crash_drop: float
    caution_time: float
    stuck_speed: float
    stuck_time: float
    crawl_speed: float
    free_time: float  # [s]
    nitro_time: float
    long_ago: float
    drift_shows: float
    release_time: float
    boost_time: float
    big_boost_time: float


def age_memory(
    rules: npt.NDArray[np.float64], memory: FloatArray, speed: FloatArray, skeed_factor: FloatArray
) -> None:
    """Advances the memory by one step."""
    known, of, clocks = _MemoryRules(*rules.tolist()), PlanMemory(*memory), memory[_CLOCKS]
    np.maximum(clocks - 1, 0, out=clocks)
    of.gain[:] = speed - of.speed
    of.caution_steps[of.gain < -known.crash_drop] = known.caution_time
    of.speed[:] = speed
    pace, is_free = np.abs(speed), of.rescue_steps == 0
    is_still = (pace < known.stuck_speed) & is_free
    of.still_steps[:] = np.where(is_still, of.still_steps + 1, 0)
    crawls = (pace < known.crawl_speed) & is_free
    of.crawl_steps[:] = np.where(crawls, of.crawl_steps + 1, 0)
    of.free_steps[:] = np.where(is_still, 0, of.free_steps + 1)
    of.reverses[of.free_steps * known.step > known.free_time] = 0
    of.since_fire[:] = np.minimum(of.since_fire + 1, known.long_ago)
    is_over = (of.drift_steps >= known.drift_shows) & (skeed_factor <= 1.0)
    of.drift_side[is_over] = of.drift_steps[is_over] = 0


def write_memory(
    rules: npt.NDArray[np.float64], memory: FloatArray, out: FloatArray, first: int
) -> None:
    """Writes a policy's inputs from the memory."""
    known, of = _MemoryRules(*rules.tolist()), PlanMemory(*memory)
    drift = np.minimum(of.drift_steps / 30.0, 2.0)
    columns = (
        of.turn,
        of.drift_turn * (of.drift_side != 0),
        drift * of.drift_side,
        drift,
        of.release_steps / known.release_time,
        of.boost_steps / known.boost_time,
        of.big_boost_steps / known.big_boost_time,
        of.nitro_steps / max(known.nitro_time, 1),
        of.caution_steps / max(known.caution_time, 1),
        of.still_steps / known.stuck_time,
        np.minimum(np.maximum(of.gain / 5.0, -2.0), 2.0),
        of.since_fire / known.long_ago,
    )
    for number, column in enumerate(columns, start=first):
        out[:, number] = column
