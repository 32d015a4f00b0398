"""Wrappers: other forms of an agent's observation and action.

Each wrapper is an ordinary Gymnasium wrapper around one kart's environment. The same
wrappers serve a whole race: :class:`AgentChains` and :class:`MonoAgentWrapperAdapter`
run a chain of them for every agent, and the built-in ones run once for all agents that
share a chain (:class:`BatchedWrapper`).
"""

from stkzoo.wrappers.action_observation import ActionObservationWrapper
from stkzoo.wrappers.adapter import MonoAgentWrapperAdapter
from stkzoo.wrappers.batched import BatchedWrapper
from stkzoo.wrappers.camera import CameraObservations
from stkzoo.wrappers.chain import AgentChains
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
    "AgentChains",
    "BatchedWrapper",
    "CameraObservations",
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
