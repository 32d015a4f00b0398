"""The built-in views: each is a name and the wrappers around the ``full`` view.

To add a view, add a :class:`View` to :data:`SHIPPED`. Its Gymnasium id, its support in vector
environments and its tests follow automatically. Agents with equal views are processed together.
"""

from __future__ import annotations

from stkzoo.views.registry import CAMERA_VIEWS, VIEWS, View
from stkzoo.wrappers import (
    CameraObservations,
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    JoinedObservations,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)
from stkzoo.wrappers.control import ControlWrapper
from stkzoo.wrappers.marl import ActionMasks
from stkzoo.wrappers.racing import ContestObservations, RacingActions, RacingObservations

_SIMPLE = (ConstantSizedObservations, PolarObservations)
_MULTIDISCRETE = (*_SIMPLE, DiscreteActionsWrapper, FlattenerWrapper)
_DISCRETE = (*_MULTIDISCRETE, FlattenMultiDiscreteActions)
_CONTINUOUS = (*_SIMPLE, OnlyContinuousActionsWrapper, FlattenerWrapper)

#: The built-in views.
SHIPPED = (
    View("full", "Everything a kart sees, in lists of varying length; the game's own actions."),
    View(
        "ground",
        "``full``, a racing line, and the ground beside the road: walls, drops, zippers.",
        needs=frozenset({"ground"}),
    ),
    View(
        "simple",
        "The nearest five items, karts and track segments, in polar coordinates.",
        _SIMPLE,
    ),
    View(
        "flattened",
        "``simple``, with observations and actions as one continuous and one discrete vector.",
        (*_SIMPLE, FlattenerWrapper),
    ),
    View(
        "flattened_continuous_actions",
        "``flattened``, with acceleration and steering as the only actions.",
        _CONTINUOUS,
    ),
    View(
        "flattened_multidiscrete",
        "``flattened``, with acceleration and steering in steps.",
        _MULTIDISCRETE,
    ),
    View(
        "flattened_discrete",
        "``flattened_multidiscrete``, with one number for the whole action.",
        _DISCRETE,
    ),
    View(
        "box_discrete",
        "``flattened_discrete``, with the whole observation in one vector.",
        (*_DISCRETE, JoinedObservations),
    ),
    View(
        "box_continuous",
        "``flattened_continuous_actions``, with the whole observation in one vector.",
        (*_CONTINUOUS, JoinedObservations),
    ),
    View(
        "masked_discrete",
        "``box_discrete``, with a mask of the actions that have an effect.",
        (*_DISCRETE, ActionMasks, JoinedObservations),
    ),
    View(
        "racing",
        "The road ahead, nearby karts and items as one vector; five small choices as the action.",
        (RacingObservations, RacingActions),
    ),
    View(
        "contest",
        "``racing``, and the standing: rank, progress, and the motion of the nearest karts.",
        (ContestObservations, RacingActions),
        needs=frozenset({"standing"}),
    ),
    View(
        "control",
        "``simple``, with speed [m/s] and steering angle [rad] as the action.",
        (*_SIMPLE, ControlWrapper),
    ),
    View(
        "flattened_control",
        "``flattened``, with speed and steering angle as the action, each from -1 to 1.",
        (*_SIMPLE, ControlWrapper, FlattenerWrapper),
        options={"normalize_act": True},
    ),
    View(
        "camera",
        "``flattened_discrete``, with the picture of the kart's camera, 84 by 84 pixels.",
        (*_DISCRETE, CameraObservations),
        needs=frozenset({"camera"}),
    ),
)

VIEWS |= {view.name: view for view in SHIPPED if "camera" not in view.needs}
CAMERA_VIEWS |= {view.name: view for view in SHIPPED if "camera" in view.needs}
