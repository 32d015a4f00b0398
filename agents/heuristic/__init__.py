"""A driver made of rules, with nothing learned: it beats the game's bots on most tracks.

It is the planner (:mod:`stkzoo.agents.planning`) for one kart: of all plans it begins the one that
is worth most. It sees the ``full`` view and does not look at other karts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from stkzoo.agents.planning.driver import PlanDriver
from stkzoo.agents.planning.parameters import DriverParameters

__all__ = [
    "PARAMETERS",
    "create_state",
    "env_name",
    "get_actor",
    "get_batch_actor",
    "player_name",
]

#: The environment that the driver was made for.
env_name = "supertuxkart/full-v0"

#: The name to show.
player_name = "heuristic"

#: The numbers that plans are weighed by: other karts cost nothing.
PARAMETERS = replace(DriverParameters(), bump_cost=0.0)


def create_state(parameters: DriverParameters = PARAMETERS) -> PlanDriver:
    """What the driver remembers in one race.

    Args:
        parameters: the numbers that plans are weighed by.
    """
    return PlanDriver(1, parameters)


def get_actor(
    module_dir: object, observation_space: Any, action_space: Any
) -> Callable[[PlanDriver, Mapping[str, Any]], dict[str, Any]]:
    """The driver; it needs none of the arguments, which every driver is given.

    Args:
        module_dir: folder of the driver's module, where others keep their weights.
        observation_space: the agent's observation space.
        action_space: the agent's action space.
    """
    del module_dir, observation_space, action_space
    return PlanDriver.drive


def get_batch_actor(module_dir: object) -> Callable[..., list[dict[str, Any]]]:
    """The driver of several karts at once.

    Args:
        module_dir: folder of the driver's module.
    """
    del module_dir
    return PlanDriver.drive_together
