"""The table of plans that :func:`stkzoo.kernel.weigh_plans` reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]


class PlanTable(NamedTuple):
    """The plans of all states: ``S`` states, ``T`` moments, ``C`` plans.

    Attributes:
        spans: ``(T,)`` how long the moments last [s].
        least: ``(S, T, C)`` share of full lock that can be turned, positive to the right, from
        most: ``(S, T, C)`` to this.
        drifts: ``(S, T, C)`` 1 where the kart drifts.
        releases: ``(S, T, C)`` 1 where it goes on turning after a drift.
        slower: ``(S, T, C)`` change of speed [m/s].
        lanes: ``(S, T, C)`` where to drive, -1 is the left edge of the road, 1 the right one.
        items: ``(S, C)`` number of the item to drive over instead, -1 for none.
        manoeuvres: ``(S, C)`` what the plan begins with; -1 is no plan.
        boosts: ``(S, C)`` 0 if it earns the small boost, 1 if the big one, -1 if none.
        boost_steps: ``(S, C)`` in how many steps.
        needs_drift: ``(S, C)`` whether it is for karts that may begin a drift.
    """

    spans: FloatArray
    least: FloatArray
    most: FloatArray
    drifts: FloatArray
    releases: FloatArray
    slower: FloatArray
    lanes: FloatArray
    items: IntArray
    manoeuvres: IntArray
    boosts: IntArray
    boost_steps: FloatArray
    needs_drift: npt.NDArray[np.bool_]
