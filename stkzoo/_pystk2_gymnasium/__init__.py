"""The names of ``pystk2_gymnasium``, provided by stkzoo."""

from __future__ import annotations

import sys
from types import ModuleType

from stkzoo._pystk2_gymnasium import (
    definitions,
    envs,
    stk_wrappers,
    utils,
    vecenv,
    wrappers,
)
from stkzoo._pystk2_gymnasium.definitions import (
    ActionObservationWrapper,
    AgentException,
    AgentSpec,
    CameraMode,
)
from stkzoo._pystk2_gymnasium.stk_wrappers import (
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)
from stkzoo._pystk2_gymnasium.vecenv import make_stkrace_vec
from stkzoo._pystk2_gymnasium.wrappers import (
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


def modules() -> dict[str, ModuleType]:
    """This package and its modules, by the names that they have in ``pystk2_gymnasium``."""
    return {
        name.replace(__name__, "pystk2_gymnasium", 1): module
        for name, module in list(sys.modules.items())
        if f"{name}.".startswith(f"{__name__}.")
    }
