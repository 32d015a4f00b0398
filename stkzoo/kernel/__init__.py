"""The inner loops of a step, in C.

Except for the named tuples, each name in this module comes from the extension ``_kernel``. Its stub
``_kernel.pyi`` documents and types the names; ``tests/kernel`` compares them with implementations
in NumPy (``tests/oracle``).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt


def not_built(reason: object) -> ImportError:
    """Returns the error for an extension that is missing or out of date.

    Args:
        reason: what is wrong with it.
    """
    from stkzoo._installation import pip_install  # slow, and engine processes do not need it

    root = Path(__file__).parents[2]
    is_checkout = (root / "setup.py").exists()
    remedy = pip_install(f'-e "{root}"') if is_checkout else "install stkzoo again"
    return ImportError(f"stkzoo's C extension is not built for this code ({reason}): {remedy}")


try:
    from stkzoo.kernel._kernel import (
        ActionReader,
        CarController,
        EventCounter,
        GameStepper,
        KartObserver,
        Mlp,
        RacingObserver,
        StepScorer,
        TrackGraph,
        age_memory,
        join_rows,
        layouts,
        look_along,
        measure_message,
        present_plans,
        stack_vectors,
        survey_road,
        trace_roads,
        weigh_plans,
        write_memory,
    )
except ImportError as error:
    raise not_built(error) from None

__all__ = [
    "ActionReader",
    "CarController",
    "EventCounter",
    "GameStepper",
    "KartObserver",
    "Mlp",
    "MotionRules",
    "MotionState",
    "PlanMemory",
    "PlanTable",
    "RacingObserver",
    "StepScorer",
    "TrackGraph",
    "age_memory",
    "join_rows",
    "layouts",
    "look_along",
    "measure_message",
    "present_plans",
    "stack_vectors",
    "survey_road",
    "trace_roads",
    "weigh_plans",
    "write_memory",
]


class PlanTable(NamedTuple):
    """The plans of all states: ``S`` states, ``T`` moments, ``C`` plans.

    Attributes:
        spans: ``(T,)`` duration of each moment [s].
        least: ``(S, T, C)`` lower limit of the turn, positive to the right [fraction of full lock].
        most: ``(S, T, C)`` upper limit of the turn [fraction of full lock].
        drifts: ``(S, T, C)`` 1 while the kart drifts.
        releases: ``(S, T, C)`` 1 while it keeps turning after a drift.
        slower: ``(S, T, C)`` change of speed [m/s].
        lanes: ``(S, T, C)`` lateral target; -1 is the left edge of the road, 1 the right edge.
        items: ``(S, C)`` number of the item to drive over instead; -1 for none.
        maneuvers: ``(S, C)`` first maneuver of the plan; -1 if there is no plan.
        boosts: ``(S, C)`` boost that the plan earns: 0 for the small one, 1 for the big one, -1 for
            none.
        boost_steps: ``(S, C)`` time until it earns the boost [steps].
        needs_drift: ``(S, C)`` whether only karts that may begin a drift can follow the plan.
    """

    spans: npt.NDArray[np.float32]
    least: npt.NDArray[np.float32]
    most: npt.NDArray[np.float32]
    drifts: npt.NDArray[np.float32]
    releases: npt.NDArray[np.float32]
    slower: npt.NDArray[np.float32]
    lanes: npt.NDArray[np.float32]
    items: npt.NDArray[np.intp]
    maneuvers: npt.NDArray[np.intp]
    boosts: npt.NDArray[np.intp]
    boost_steps: npt.NDArray[np.float32]
    needs_drift: npt.NDArray[np.bool_]


class PlanMemory(NamedTuple):
    """The memory of the drivers of ``A`` karts, ``(A,)`` float32 each. Times are in steps.

    Attributes:
        speed: forward speed in the last step [m/s].
        gain: change of speed in that step [m/s].
        turn: turn in that step, positive to the right [fraction of full lock].
        drift_turn: turn in the last step of a drift [fraction of full lock].
        drift_side: 1 in a drift to the right, -1 to the left, 0 outside drifts.
        drift_steps: duration of the drift so far.
        still_steps: time for which the kart has stood still.
        crawl_steps: time for which the kart has crawled.
        free_steps: time for which the kart has not stood still.
        reverses: number of times that the kart has reversed without getting free.
        lost_steps: time for which the kart has been far off the road.
        since_fire: time since the last shot.
        held_offset: steering offset from the plan that is held [fraction of full lock].
        hold_steps: remaining time of that offset; this and all attributes below count down to 0.
        hop_steps: time until another drift can begin.
        release_steps: remaining time of the turn after a drift.
        boost_steps: remaining time of the boost of a short drift.
        big_boost_steps: remaining time of the boost of a long drift.
        nitro_steps: remaining time of a burst of nitro.
        caution_steps: remaining time of caution after a crash.
        reverse_steps: remaining time of reversing.
        rescue_steps: remaining time of a rescue.
    """

    speed: npt.NDArray[np.float32]
    gain: npt.NDArray[np.float32]
    turn: npt.NDArray[np.float32]
    drift_turn: npt.NDArray[np.float32]
    drift_side: npt.NDArray[np.float32]
    drift_steps: npt.NDArray[np.float32]
    still_steps: npt.NDArray[np.float32]
    crawl_steps: npt.NDArray[np.float32]
    free_steps: npt.NDArray[np.float32]
    reverses: npt.NDArray[np.float32]
    lost_steps: npt.NDArray[np.float32]
    since_fire: npt.NDArray[np.float32]
    held_offset: npt.NDArray[np.float32]
    hold_steps: npt.NDArray[np.float32]
    hop_steps: npt.NDArray[np.float32]
    release_steps: npt.NDArray[np.float32]
    boost_steps: npt.NDArray[np.float32]
    big_boost_steps: npt.NDArray[np.float32]
    nitro_steps: npt.NDArray[np.float32]
    caution_steps: npt.NDArray[np.float32]
    reverse_steps: npt.NDArray[np.float32]
    rescue_steps: npt.NDArray[np.float32]


class MotionRules(NamedTuple):
    """Parameters of the network that models the karts' motion. Times are in its steps.

    Attributes:
        step: length of a step [s].
        small_drift: duration of a drift that earns the small boost.
        big_drift: duration of a drift that earns the big boost.
        small_lasts: duration of the small boost.
        big_lasts: duration of the big boost.
        release_lasts: longest time for which a kart keeps turning after a drift.
        brake_lasts: duration of braking in a plan that brakes.
    """

    step: float
    small_drift: float
    big_drift: float
    small_lasts: float
    big_lasts: float
    release_lasts: float
    brake_lasts: float


class MotionState(NamedTuple):
    """The state of karts at a step, with the memory of their drivers after they have acted.

    Attributes:
        speed: forward speed [m/s].
        slide: speed to the right [m/s].
        yaw: turn in the previous step, positive to the right [rad].
        turn: turn, positive to the right [fraction of full lock].
        turn_before: turn in the previous step [fraction of full lock].
        side: side of the drift: 1 right, -1 left, 0 none.
        steps: duration of the drift so far.
        release: remaining time of the turn after a drift.
        drift_turn: turn in the last step of a drift [fraction of full lock].
        boost: remaining time of the boost of a short drift.
        big_boost: remaining time of the boost of a long drift.
        brake: 1 if the kart brakes.
    """

    speed: npt.NDArray[np.float32]
    slide: npt.NDArray[np.float32]
    yaw: npt.NDArray[np.float32]
    turn: npt.NDArray[np.float32]
    turn_before: npt.NDArray[np.float32]
    side: npt.NDArray[np.float32]
    steps: npt.NDArray[np.float32]
    release: npt.NDArray[np.float32]
    drift_turn: npt.NDArray[np.float32]
    boost: npt.NDArray[np.float32]
    big_boost: npt.NDArray[np.float32]
    brake: npt.NDArray[np.float32]

    def inputs(self, rules: MotionRules) -> npt.NDArray[np.float32]:
        """Returns the inputs of the network, ``(..., 16)``."""
        columns = (
            *self._replace(steps=np.minimum(self.steps, rules.big_drift)),
            self.side / (1.0 + self.steps),
            self.steps >= rules.small_drift,
            self.turn * self.side,
            np.where(self.release > 0, self.turn, 0),
        )
        return np.stack([np.asarray(column, np.float32) for column in columns], axis=-1)
