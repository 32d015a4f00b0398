"""Multi-agent kart racing on the real SuperTuxKart engine.

>>> from stkzoo import race_v0
>>> env = race_v0.parallel_env(num_kart=2, track="lighthouse", view="flattened_discrete")
>>> observations, infos = env.reset(seed=42)
>>> sorted(observations)
['kart_0', 'kart_1']
>>> env.close()

Importing this package registers the environments with Gymnasium (``supertuxkart/...-v0``)
and PettingZoo (``supertuxkart/race-v0``). The game itself is loaded in processes of its
own, when an environment is made.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from stkzoo.config import AgentSpec, RandomStart, Start
from stkzoo.env.ids import register_ids, register_view
from stkzoo.errors import (
    ActionError,
    AgentError,
    AgentException,
    AgentTimeout,
    ApiOrderError,
    AssetError,
    ConfigError,
    EngineCrashed,
    EngineError,
    EngineTimeout,
    ProtocolError,
    RemoteError,
    StkzooError,
)
from stkzoo.names import AttachmentType, CameraMode, GroundKind, ItemType, Phase, PowerupType
from stkzoo.wrappers import (
    ActionObservationWrapper,
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    MonoAgentWrapperAdapter,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)

if TYPE_CHECKING:
    from stkzoo.env.gymnasium_api import STKRaceEnv, STKRaceMultiEnv
    from stkzoo.env.parallel import RaceParallelEnv
    from stkzoo.env.scenario import Scenario
    from stkzoo.env.starts import StartCurriculum
    from stkzoo.env.state import RaceState
    from stkzoo.env.vec.env import RaceVectorEnv
    from stkzoo.env.vector import make_stkrace_vec
    from stkzoo.mdp.rewards import Reward

__version__ = "0.1.0"

__all__ = [
    "ActionError",
    "ActionObservationWrapper",
    "AgentError",
    "AgentException",
    "AgentSpec",
    "AgentTimeout",
    "ApiOrderError",
    "AssetError",
    "AttachmentType",
    "CameraMode",
    "ConfigError",
    "ConstantSizedObservations",
    "DiscreteActionsWrapper",
    "EngineCrashed",
    "EngineError",
    "EngineTimeout",
    "FlattenMultiDiscreteActions",
    "FlattenerWrapper",
    "GroundKind",
    "ItemType",
    "MonoAgentWrapperAdapter",
    "OnlyContinuousActionsWrapper",
    "Phase",
    "PolarObservations",
    "PowerupType",
    "ProtocolError",
    "RaceParallelEnv",
    "RaceState",
    "RaceVectorEnv",
    "RandomStart",
    "RemoteError",
    "Reward",
    "STKRaceEnv",
    "STKRaceMultiEnv",
    "Scenario",
    "Start",
    "StartCurriculum",
    "StkzooError",
    "make_stkrace_vec",
    "register_view",
]

#: Names that are loaded when they are first used.
_LAZY = {
    "RaceParallelEnv": "stkzoo.env.parallel",
    "RaceState": "stkzoo.env.state",
    "RaceVectorEnv": "stkzoo.env.vec.env",
    "Reward": "stkzoo.mdp.rewards",
    "STKRaceEnv": "stkzoo.env.gymnasium_api",
    "STKRaceMultiEnv": "stkzoo.env.gymnasium_api",
    "Scenario": "stkzoo.env.scenario",
    "StartCurriculum": "stkzoo.env.starts",
    "make_stkrace_vec": "stkzoo.env.vector",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(importlib.import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


register_ids()
