"""A driver that plans with the game itself, by a two-stage search in copies of the race.

Every few steps it drives candidates, each in a copy of the race. A candidate is a learned driver
(by default, *ace*) with a change of its steering offset or its maneuver that holds for some steps.
It drives the best candidates further and follows the best of them.

It needs the environment and not only observations. In a race, it is the driver ``planner``; it must
be the only one besides the game's AI. In a loop of your own:

    planner = Planner(seed=0)
    while env.agents:
        observations, *_ = env.step({"kart_0": planner.act(env, observations["kart_0"])})
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from typing import Any, NoReturn

from stkzoo import RaceParallelEnv
from stkzoo.errors import ConfigError

from .copies import Candidate
from .planner import Planner, PlannerSettings, base_policy, only_agent

__all__ = [
    "Candidate",
    "Planner",
    "PlannerSettings",
    "base_policy",
    "env_name",
    "get_actor",
    "get_race_actor",
    "player_name",
]
__dir__ = __all__.copy

#: Id of the environment whose observations the planner reads.
env_name = "supertuxkart/full-v0"

#: Display name.
player_name = "planner"


@contextmanager
def get_race_actor(env: RaceParallelEnv, seed: int) -> Iterator[Callable[[Any], Any]]:
    """Yields the driver of the only agent of a race that the game's AI does not drive.

    The copies of the race end with the context.

    Args:
        env: environment of the race.
        seed: seed of the planner.

    Raises:
        ConfigError: there are several such agents.
    """
    only_agent(env)
    with closing(Planner(seed=seed)) as planner:
        yield partial(planner.act, env)


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> NoReturn:
    """Raises an error, because this driver needs the environment.

    Raises:
        ConfigError: always.
    """
    del module_dir, observation_space, action_space
    raise ConfigError(
        "the planner copies the race, so it drives only in races of its own: run_race and the "
        "commands race, demos and benchmark; in your own environment, use "
        "stkzoo.agents.planner.Planner"
    )
