"""Wrappers: other forms of an agent's observation and action.

Each wrapper is an ordinary Gymnasium wrapper around one kart's environment.
:class:`MonoAgentWrapperAdapter` puts such wrappers around each agent of an environment of
many; :mod:`stkzoo.views` runs them for all agents of a race.
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
