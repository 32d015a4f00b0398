"""The names of ``pystk2_gymnasium``, provided by stkzoo."""

from stkzoo.compat.pystk2_gymnasium import (
    definitions,
    envs,
    stk_wrappers,
    utils,
    vecenv,
    wrappers,
)
from stkzoo.compat.pystk2_gymnasium.definitions import (
    ActionObservationWrapper,
    AgentException,
    AgentSpec,
    CameraMode,
)
from stkzoo.compat.pystk2_gymnasium.stk_wrappers import (
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)
from stkzoo.compat.pystk2_gymnasium.vecenv import make_stkrace_vec
from stkzoo.compat.pystk2_gymnasium.wrappers import (
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    MonoAgentWrapperAdapter,
)

__version__ = "0.10.0"

__all__ = [
    "ActionObservationWrapper",
    "AgentException",
    "AgentSpec",
    "CameraMode",
    "ConstantSizedObservations",
    "DiscreteActionsWrapper",
    "FlattenMultiDiscreteActions",
    "FlattenerWrapper",
    "MonoAgentWrapperAdapter",
    "OnlyContinuousActionsWrapper",
    "PolarObservations",
    "definitions",
    "envs",
    "make_stkrace_vec",
    "stk_wrappers",
    "utils",
    "vecenv",
    "wrappers",
]
