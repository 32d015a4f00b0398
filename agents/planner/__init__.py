"""A driver that looks ahead with the game itself: random shooting on saved states.

Every few steps it saves the race, tries some random changes of what the heuristic driver
would do, each in a copy of the race, and goes on with the best. It needs the environment,
not only what a kart sees, so that it is used by itself and not by a driver's name:

    planner = Planner(seed=0)
    while env.agents:
        observations, *_ = env.step({"kart_0": planner.act(env, observations["kart_0"])})
"""

from __future__ import annotations

from typing import Any, NoReturn

from stkzoo.errors import ConfigError

from .planner import Plan, Planner, PlannerSettings

__all__ = ["Plan", "Planner", "PlannerSettings", "env_name", "get_actor", "player_name"]

#: The environment whose views the planner reads.
env_name = "supertuxkart/full-v0"

#: The name to show.
player_name = "planner"


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> NoReturn:
    """Refuses: no view of a kart is enough for this driver.

    Raises:
        ConfigError: always.
    """
    del module_dir, observation_space, action_space
    raise ConfigError(
        "the planner needs the race's environment, which a driver chosen by name is not given; "
        "use stkzoo.agents.planner.Planner with an environment of one agent"
    )
