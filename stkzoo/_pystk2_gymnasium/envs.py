"""Names of ``pystk2_gymnasium.envs``."""

from __future__ import annotations

from typing import Any

from stkzoo._left_out import without_names
from stkzoo._pystk2_gymnasium.utils import max_enum_value as max_enum_value
from stkzoo._pystk2_gymnasium.utils import rotate as rotate
from stkzoo._pystk2_gymnasium.utils import rotate_batch as rotate_batch
from stkzoo.config import AgentSpec as AgentSpec
from stkzoo.env.gymnasium_api import GymnasiumRaceEnv
from stkzoo.env.gymnasium_api import STKRaceEnv as STKRaceEnv
from stkzoo.env.gymnasium_api import STKRaceMultiEnv as STKRaceMultiEnv
from stkzoo.mdp.spaces import kart_action_space as kart_action_space
from stkzoo.mdp.spaces import kart_observation_space as kart_observation_space
from stkzoo.names import Phase as Phase

BaseSTKRaceEnv = GymnasiumRaceEnv

#: Actions of the ``full`` view and of :class:`~stkzoo.wrappers.DiscreteActionsWrapper`, for
#: annotations.
STKAction = STKDiscreteAction = dict[str, Any]

_LEFT_OUT = {
    **dict.fromkeys(("DirectSTKInterface", "PySTKProcess", "STKInterface"), "use an environment"),
    **dict.fromkeys(("PathCache", "get_path_cache"), "use track.nodes_ahead(numpy.array([node]))"),
    "get_action": "step takes the action as it is",
}
__getattr__ = without_names("pystk2_gymnasium.envs", _LEFT_OUT)
