"""How karts move: facts measured in races, and a network that has learned it.

A drift is a slide to the side to which the kart steers when the drift begins. It earns a boost at
its end if it has lasted long enough. Afterwards the kart keeps turning for a while and cannot begin
another drift.

The network predicts how much a kart turns and how its speed changes in the next step. Plans are
simulated with it or in arcs. ``python -m benchmarks.learn_motion`` trained it on races on the
training tracks.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from . import FloatArray

#: Game time between two calls of the driver [s]; the steps below have this length.
STEP = 0.1

#: Turn in a drift for steering of -1 and 1 [fraction of full lock].
DRIFT_TURN = (0.2, 0.8)

#: Steps of drifting that earn the small boost (4.5 m/s) and the big boost (6.5 m/s).
BOOST_STEPS = (11, 31)
#: Duration of the boosts in steps, including half of the time in which they fade.
BOOST_LASTS = (35, 45)

#: Minimum steps between the beginnings of two drifts, because a drift begins with a hop. An earlier
#: request is delayed, and the drift then begins to the side to which the kart steers at that time.
DRIFT_APART = 4

#: After a drift the kart keeps turning, and cannot drift, for as many steps as it has drifted, but
#: at most this many.
RELEASE_STEPS = 7
#: Turning rate after a drift, per fraction of full lock at its end [rad/s].
RELEASE_TURN = 1.25 / 0.7

#: Maximum steps of a rescue, during which the kart reports the speed that it had before.
RESCUE_STEPS = 14

#: Deceleration of the brake [m/s²].
BRAKING = 22.0

#: Duration of braking in plans that brake [s].
BRAKE_TIME = 0.3


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

    speed: FloatArray
    slide: FloatArray
    yaw: FloatArray
    turn: FloatArray
    turn_before: FloatArray
    side: FloatArray
    steps: FloatArray
    release: FloatArray
    drift_turn: FloatArray
    boost: FloatArray
    big_boost: FloatArray
    brake: FloatArray

    def inputs(self) -> FloatArray:
        """Returns the inputs of the network, ``(..., 16)``."""
        columns = (
            *self._replace(steps=np.minimum(self.steps, BOOST_STEPS[1])),
            self.side / (1.0 + self.steps),
            self.steps >= BOOST_STEPS[0],
            self.turn * self.side,
            np.where(self.release > 0, self.turn, 0),
        )
        return np.stack([np.asarray(column, np.float32) for column in columns], axis=-1)


#: The network's weights: ``w0``, ``b0``, ``w1``, ``b1``, ``w2`` and ``b2``.
WEIGHTS = Path(__file__).with_name("motion.safetensors")

#: Names of the network's layers, in order: matrices ``(outputs, inputs)`` and biases.
LAYERS = ("w0", "b0", "w1", "b1", "w2", "b2")


@lru_cache(maxsize=1)
def learned_motion() -> tuple[npt.NDArray[Any], ...]:
    """Returns the layers of the network, for ``plan_karts``."""
    from stkzoo.agents.pretrained.weights import load_weights  # only plans with the network need it

    weights = load_weights(WEIGHTS)
    return tuple(weights[name] for name in LAYERS)
