"""Wrappers that change the observations and actions of an agent.

Each wrapper is an ordinary Gymnasium wrapper around the environment of one kart.
:class:`MonoAgentWrapperAdapter` applies such wrappers to each agent of a multi-agent environment;
:mod:`stkzoo.views` runs them for all agents of a race.
"""

from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.wrappers.actions import (
    DiscreteActionsWrapper,
    Discretizer,
    FlattenMultiDiscreteActions,
    OnlyContinuousActionsWrapper,
)
from stkzoo.wrappers.adapter import MonoAgentWrapperAdapter
from stkzoo.wrappers.camera import CameraObservations
from stkzoo.wrappers.flattening import FlattenerWrapper, JoinedObservations, SpaceFlattener
from stkzoo.wrappers.observations import ConstantSizedObservations, PolarObservations

__all__ = [
    "ActionObservationWrapper",
    "CameraObservations",
    "CompiledWrapper",
    "ConstantSizedObservations",
    "DiscreteActionsWrapper",
    "Discretizer",
    "FlattenMultiDiscreteActions",
    "FlattenerWrapper",
    "JoinedObservations",
    "MonoAgentWrapperAdapter",
    "OnlyContinuousActionsWrapper",
    "PolarObservations",
    "SpaceFlattener",
]
__dir__ = __all__.copy
