"""The decision process: observations, rewards, actions and endings, in plain numpy.

Every part sees the whole race at once, as arrays with a leading axis of karts or agents.
"""

from stkzoo.mdp.geometry import squared
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space

__all__ = ["kart_action_space", "kart_observation_space", "squared"]
