"""The inner loops of a step, once in C and once in numpy.

Every name here but :class:`PlanTable` is a class or function of the compiled extension
``_kernel``, or its twin in :mod:`stkzoo.kernel.reference`, which does the same in numpy. This
module alone decides which: the extension, unless it is not built here or ``STKZOO_KERNEL=off`` is
set. The stub ``_kernel.pyi`` types both, and ``tests/kernel`` runs each name against its twin.

Attributes:
    IS_COMPILED: whether the names are those of the extension.
"""

from __future__ import annotations

import importlib
import os
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from stkzoo.kernel._kernel import *  # noqa: F403 - all names of the stub

#: The modules of the twins, below ``stkzoo.kernel.reference``. Each is imported when it is first
#: needed: some are made of formulas from packages that use the kernel themselves.
_TWINS = {
    "ActionReader": "action_reader",
    "CarController": "car_controller",
    "EventCounter": "event_counter",
    "GameStepper": "game_stepper",
    "KartObserver": "kart_observer",
    "RacingObserver": "racing_observer",
    "StepScorer": "step_scorer",
    "TrackGraph": "track_graph",
    "join_rows": "rows",
    "layouts": "rows",
    "measure_message": "messages",
    "weigh_plans": "plan_weigher",
}

__all__ = sorted(["IS_COMPILED", "PlanTable", *_TWINS])


def _extension() -> ModuleType | None:
    if os.environ.get("STKZOO_KERNEL") == "off":
        return None
    try:
        return importlib.import_module("stkzoo.kernel._kernel")
    except ImportError:
        return None


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

    spans: npt.NDArray[np.float32]
    least: npt.NDArray[np.float32]
    most: npt.NDArray[np.float32]
    drifts: npt.NDArray[np.float32]
    releases: npt.NDArray[np.float32]
    slower: npt.NDArray[np.float32]
    lanes: npt.NDArray[np.float32]
    items: npt.NDArray[np.intp]
    manoeuvres: npt.NDArray[np.intp]
    boosts: npt.NDArray[np.intp]
    boost_steps: npt.NDArray[np.float32]
    needs_drift: npt.NDArray[np.bool_]


_compiled = _extension()
IS_COMPILED = _compiled is not None


def __getattr__(name: str) -> Any:
    if name not in _TWINS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    twin = f"stkzoo.kernel.reference.{_TWINS[name]}"
    value = getattr(_compiled or importlib.import_module(twin), name)
    globals()[name] = value
    return value
