"""A driver that plans with the game itself, by random shooting on saved states.

Every few steps it saves the race, tries random changes of the heuristic driver's actions, each in a
copy of the race, and continues with the best one. It needs the environment and not only
observations, so it has no driver name; use it directly:

    planner = Planner(seed=0)
    while env.agents:
        observations, *_ = env.step({"kart_0": planner.act(env, observations["kart_0"])})
"""

from __future__ import annotations

from typing import Any, NoReturn

from stkzoo.errors import ConfigError

from .planner import Plan, Planner, PlannerSettings

__all__ = ["Plan", "Planner", "PlannerSettings", "env_name", "get_actor", "player_name"]

#: Id of the environment whose observations the planner reads.
env_name = "supertuxkart/full-v0"

#: Display name.
player_name = "planner"


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> NoReturn:
    """Raises an error, because this driver needs the environment.

    Raises:
        ConfigError: always.
    """
    del module_dir, observation_space, action_space
    raise ConfigError(
        "the planner needs the race's environment, which a driver chosen by name is not given; "
        "use stkzoo.agents.planner.Planner with an environment of one agent"
    )
