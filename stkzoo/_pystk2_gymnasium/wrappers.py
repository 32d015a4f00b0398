"""Names of ``pystk2_gymnasium.wrappers``."""

from stkzoo.wrappers import (
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    MonoAgentWrapperAdapter,
    SpaceFlattener,
)

__all__ = [
    "FlattenMultiDiscreteActions",
    "FlattenerWrapper",
    "MonoAgentWrapperAdapter",
    "SpaceFlattener",
]
