"""Names of ``pystk2_gymnasium.wrappers``."""

from stkzoo.errors import AgentException as AgentException
from stkzoo.wrappers import ActionObservationWrapper as ActionObservationWrapper
from stkzoo.wrappers import FlattenerWrapper as FlattenerWrapper
from stkzoo.wrappers import FlattenMultiDiscreteActions as FlattenMultiDiscreteActions
from stkzoo.wrappers import MonoAgentWrapperAdapter as MonoAgentWrapperAdapter
from stkzoo.wrappers import SpaceFlattener as SpaceFlattener
