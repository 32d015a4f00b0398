"""Names of ``pystk2_gymnasium.envs``."""

from stkzoo.config import AgentSpec
from stkzoo.env.gymnasium_base import GymnasiumRaceEnv as BaseSTKRaceEnv
from stkzoo.env.multi import STKRaceMultiEnv
from stkzoo.env.single import STKRaceEnv
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.names import Phase

__all__ = [
    "AgentSpec",
    "BaseSTKRaceEnv",
    "Phase",
    "STKRaceEnv",
    "STKRaceMultiEnv",
    "kart_action_space",
    "kart_observation_space",
]
