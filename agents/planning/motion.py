"""A network that has learned how karts move, for the simulation of plans.

It predicts how much a kart turns and how its speed changes in the next step.
``python -m stkzoo.agents.training.learn_motion`` trained it on races on the training tracks.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import MotionRules

from .kart import BOOST_LASTS, BOOST_STEPS, RELEASE_STEPS, STEP
from .plans import BRAKE_TIME

#: The network's weights: ``w0``, ``b0``, ``w1``, ``b1``, ``w2`` and ``b2``.
WEIGHTS = Path(__file__).with_name("motion.safetensors")

#: Times that the network knows.
MOTION_RULES = MotionRules(
    STEP, *BOOST_STEPS, *BOOST_LASTS, RELEASE_STEPS, round(BRAKE_TIME / STEP)
)

#: Names of the network's layers, in order: matrices ``(outputs, inputs)`` and biases.
LAYERS = ("w0", "b0", "w1", "b1", "w2", "b2")


@lru_cache(maxsize=1)
def learned_motion() -> tuple[npt.NDArray[Any], ...]:
    """Returns the argument ``motion`` of :func:`stkzoo.kernel.weigh_plans`."""
    from stkzoo.agents.pretrained.weights import load_weights  # only plans with the network need it

    weights = load_weights(WEIGHTS)
    return np.array(MOTION_RULES), *(weights[name] for name in LAYERS)
