"""Multi-agent kart racing on the real SuperTuxKart engine.

>>> from stkzoo import race_v0
>>> env = race_v0.parallel_env(num_kart=2, track="lighthouse", view="flattened_discrete")
>>> observations, infos = env.reset(seed=42)
>>> sorted(observations)
['kart_0', 'kart_1']
>>> env.close()

Importing this package registers the environments with Gymnasium (``supertuxkart/...-v0``)
and PettingZoo (``supertuxkart/race-v0``). The game itself runs in separate processes, which start
when an environment is created.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import stkzoo.kernel  # noqa: F401 - first, so that a missing extension is the only error
from stkzoo import errors, names
from stkzoo._imports import lazy_names
from stkzoo.config import AgentSpec, RandomStart, Start
from stkzoo.env.ids import register_ids, register_view
from stkzoo.errors import *  # noqa: F403 - all of them are public
from stkzoo.names import *  # noqa: F403
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
    from stkzoo.drivers import OpponentPool
    from stkzoo.env.gymnasium_api import STKRaceEnv, STKRaceMultiEnv
    from stkzoo.env.parallel import RaceParallelEnv
    from stkzoo.env.scenario import Scenario
    from stkzoo.env.state import RaceState
    from stkzoo.env.vec.env import RaceVectorEnv
    from stkzoo.env.vector import make_stkrace_vec
    from stkzoo.mdp.rewards import Reward
    from stkzoo.views import views  # the package itself, which can be called

__version__ = "1.0.0"

__all__ = [
    "ActionObservationWrapper",
    "AgentSpec",
    "ConstantSizedObservations",
    "DiscreteActionsWrapper",
    "FlattenMultiDiscreteActions",
    "FlattenerWrapper",
    "MonoAgentWrapperAdapter",
    "OnlyContinuousActionsWrapper",
    "OpponentPool",
    "PolarObservations",
    "RaceParallelEnv",
    "RaceState",
    "RaceVectorEnv",
    "RandomStart",
    "Reward",
    "STKRaceEnv",
    "STKRaceMultiEnv",
    "Scenario",
    "Start",
    "make_stkrace_vec",
    "register_view",
    "views",
]
__all__ += errors.__all__
__all__ += names.__all__
__dir__ = __all__.copy

_HOMES = {
    "stkzoo.drivers": ("OpponentPool",),
    "stkzoo.env.gymnasium_api": ("STKRaceEnv", "STKRaceMultiEnv"),
    "stkzoo.env.parallel": ("RaceParallelEnv",),
    "stkzoo.env.scenario": ("Scenario",),
    "stkzoo.env.state": ("RaceState",),
    "stkzoo.env.vec.env": ("RaceVectorEnv",),
    "stkzoo.env.vector": ("make_stkrace_vec",),
    "stkzoo.mdp.rewards": ("Reward",),
}
__getattr__ = lazy_names(__name__, _HOMES)

register_ids()
