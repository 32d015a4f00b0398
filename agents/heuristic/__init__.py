"""A driver made of rules and nothing learned: it beats the game's bots on most tracks.

Ten times a second it lists what it could do in the next two seconds (:mod:`.plans`): which lane
to drive in, whether to brake, when to drift and for how long. It drives all of that in its
head (:mod:`.forecast`), in the road's own coordinates (:mod:`.road`), and begins what gets it
farthest, boosts and items counted in metres (:mod:`.driver`, :mod:`.items`).

It sees the ``full`` view and remembers a little (:class:`DriverState`). All its numbers
stand in :class:`DriverParameters`. It was built on the training tracks of
:mod:`stkzoo.tracks` alone, and an evolution strategy has found most of its numbers there
(:mod:`stkzoo.agents.training.tune_plans`).
"""

from __future__ import annotations

from typing import Any

from stkzoo.agents.planning import DriverParameters

from .driver import DriverState, HeuristicDriver

__all__ = [
    "DriverParameters",
    "DriverState",
    "HeuristicDriver",
    "create_state",
    "env_name",
    "get_actor",
    "player_name",
]

#: The environment that the driver was made for.
env_name = "supertuxkart/full-v0"

#: The name to show.
player_name = "heuristic"

create_state = DriverState


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> HeuristicDriver:
    """The driver; it needs none of the arguments, which every driver is given.

    Args:
        module_dir: folder of the driver's module, where others keep their weights.
        observation_space: the agent's observation space.
        action_space: the agent's action space.
    """
    del module_dir, observation_space, action_space
    return HeuristicDriver()
