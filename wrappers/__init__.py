"""Wrappers: other forms of an agent's observation and action.

Each wrapper is an ordinary Gymnasium wrapper around one kart's environment.
:class:`MonoAgentWrapperAdapter` puts such wrappers around each agent of an environment of
many; :mod:`stkzoo.views` runs them for all agents of a race.
"""

from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.wrappers.adapter import MonoAgentWrapperAdapter
from stkzoo.wrappers.camera import CameraObservations
from stkzoo.wrappers.constant_size import ConstantSizedObservations
from stkzoo.wrappers.continuous_actions import OnlyContinuousActionsWrapper
from stkzoo.wrappers.discrete_actions import DiscreteActionsWrapper, Discretizer
from stkzoo.wrappers.flatten_multidiscrete import FlattenMultiDiscreteActions
from stkzoo.wrappers.flattener import FlattenerWrapper
from stkzoo.wrappers.joined import JoinedObservations
from stkzoo.wrappers.polar import PolarObservations
from stkzoo.wrappers.space_flattener import SpaceFlattener

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
