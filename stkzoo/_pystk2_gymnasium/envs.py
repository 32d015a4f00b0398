"""Names of ``pystk2_gymnasium.envs``."""

from stkzoo.config import AgentSpec as AgentSpec
from stkzoo.env.gymnasium_api import GymnasiumRaceEnv
from stkzoo.env.gymnasium_api import STKRaceEnv as STKRaceEnv
from stkzoo.env.gymnasium_api import STKRaceMultiEnv as STKRaceMultiEnv
from stkzoo.mdp.spaces import kart_action_space as kart_action_space
from stkzoo.mdp.spaces import kart_observation_space as kart_observation_space
from stkzoo.names import Phase as Phase

BaseSTKRaceEnv = GymnasiumRaceEnv
