"""The decision process: observations, rewards, events and state.

All functions process the whole race at once, as arrays with a leading axis of karts or agents.
"""

from stkzoo.mdp import rewards
from stkzoo.mdp.geometry import rotation_matrices
from stkzoo.mdp.spaces import (
    action_of,
    as_actions,
    controls_of,
    kart_action_space,
    kart_observation_space,
)

__all__ = [
    "action_of",
    "as_actions",
    "controls_of",
    "kart_action_space",
    "kart_observation_space",
    "rewards",
    "rotation_matrices",
]
__dir__ = __all__.copy
