"""A rule-based driver without learning that beats the game's bots on most tracks.

It runs the planner (:mod:`stkzoo.agents.planning`) for one kart and begins the plan with the
highest value. It uses the ``full`` view and ignores other karts.
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
__dir__ = __all__.copy

#: Id of the environment that the driver was made for.
env_name = "supertuxkart/full-v0"

#: Display name.
player_name = "heuristic"

#: Parameters of the plans, in which other karts have no cost.
PARAMETERS = replace(DriverParameters(), bump_cost=0.0)


def create_state(parameters: DriverParameters = PARAMETERS) -> PlanDriver:
    """Returns the driver's state for one race.

    Args:
        parameters: parameters of the plans.
    """
    return PlanDriver(1, parameters)


def get_actor(
    module_dir: object, observation_space: Any, action_space: Any
) -> Callable[[PlanDriver, Mapping[str, Any]], dict[str, Any]]:
    """Returns the driver; it ignores the arguments.

    Args:
        module_dir: folder of the driver's module.
        observation_space: observation space of the agent.
        action_space: action space of the agent.
    """
    del module_dir, observation_space, action_space
    return PlanDriver.drive


def get_batch_actor(module_dir: object) -> Callable[..., list[dict[str, Any]]]:
    """Returns the driver of several karts at once.

    Args:
        module_dir: folder of the driver's module.
    """
    del module_dir
    return PlanDriver.drive_together
