"""The oracle of ``agents/planning/memory.c`` in NumPy, which documents the arguments."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.memory import PlanMemory
from stkzoo.agents.planning.motion import BOOST_LASTS, RELEASE_STEPS, STEP
from stkzoo.agents.planning.parameters import DriverParameters

FloatArray = npt.NDArray[np.float32]

_NAMES = PlanMemory._fields
#: Rows of the countdowns, which are contiguous.
_CLOCKS = slice(_NAMES.index("hold_steps"), _NAMES.index("rescue_steps") + 1)


_LONG_AGO, _DRIFT_SHOWS = 40.0, 4


def age_memory(
    rules: npt.NDArray[np.float64], memory: FloatArray, speed: FloatArray, skeed_factor: FloatArray
) -> None:
    """Advances the memory by one step."""
    known, of, clocks = DriverParameters(*rules.tolist()), PlanMemory(*memory), memory[_CLOCKS]
    np.maximum(clocks - 1, 0, out=clocks)
    of.gain[:] = speed - of.speed
    of.caution_steps[of.gain < -known.crash_drop] = round(known.caution_time / STEP)
    of.speed[:] = speed
    pace, is_free = np.abs(speed), of.rescue_steps == 0
    is_still = (pace < known.stuck_speed) & is_free
    of.still_steps[:] = np.where(is_still, of.still_steps + 1, 0)
    crawls = (pace < known.crawl_speed) & is_free
    of.crawl_steps[:] = np.where(crawls, of.crawl_steps + 1, 0)
    of.free_steps[:] = np.where(is_still, 0, of.free_steps + 1)
    of.reverses[of.free_steps * STEP > known.free_time] = 0
    of.since_fire[:] = np.minimum(of.since_fire + 1, _LONG_AGO)
    is_over = (of.drift_steps >= _DRIFT_SHOWS) & (skeed_factor <= 1.0)
    of.drift_side[is_over] = of.drift_steps[is_over] = 0


def write_memory(
    rules: npt.NDArray[np.float64], memory: FloatArray, out: FloatArray, first: int
) -> None:
    """Writes a policy's inputs from the memory."""
    known, of = DriverParameters(*rules.tolist()), PlanMemory(*memory)
    drift = np.minimum(of.drift_steps / 30.0, 2.0)
    columns = (
        of.turn,
        of.drift_turn * (of.drift_side != 0),
        drift * of.drift_side,
        drift,
        of.release_steps / RELEASE_STEPS,
        of.boost_steps / BOOST_LASTS[0],
        of.big_boost_steps / BOOST_LASTS[1],
        of.nitro_steps / max(round(known.nitro_wait / STEP), 1),
        of.caution_steps / max(round(known.caution_time / STEP), 1),
        of.still_steps / round(known.stuck_time / STEP),
        np.minimum(np.maximum(of.gain / 5.0, -2.0), 2.0),
        of.since_fire / _LONG_AGO,
    )
    for number, column in enumerate(columns, start=first):
        out[:, number] = column
