"""Names of ``pystk2_gymnasium.wrappers``."""

from stkzoo._left_out import without_names
from stkzoo.errors import AgentException as AgentException
from stkzoo.wrappers import ActionObservationWrapper as ActionObservationWrapper
from stkzoo.wrappers import FlattenerWrapper as FlattenerWrapper
from stkzoo.wrappers import FlattenMultiDiscreteActions as FlattenMultiDiscreteActions
from stkzoo.wrappers import MonoAgentWrapperAdapter as MonoAgentWrapperAdapter
from stkzoo.wrappers import SpaceFlattener as SpaceFlattener

__getattr__ = without_names(
    "pystk2_gymnasium.wrappers", {"MultiMonoEnv": "MonoAgentWrapperAdapter makes its own"}
)
