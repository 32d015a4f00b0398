"""The plans of *ace* without its networks: the same ensemble with a weight of 0.

    stkzoo benchmark benchmarks/ace_plans.py --track validation --inline

The parameters of the plans are those on the card of *ace*. The heuristic uses the same ones, but
ignores other karts. Alone on the track, both are the same driver.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from stkzoo.agents.pretrained import ace
from stkzoo.agents.pretrained.ace import create_state, env_name
from stkzoo.agents.pretrained.driver import read_policy
from stkzoo.agents.pretrained.ensemble import EnsemblePolicy
from stkzoo.errors import ConfigError

__all__ = ["create_state", "env_name", "get_actor", "get_batch_actor", "player_name"]

#: Display name.
player_name = "ace without networks"


def _plans() -> EnsemblePolicy:
    folder = Path(ace.__file__).parent
    policy = read_policy(folder)
    if not isinstance(policy, EnsemblePolicy):
        raise ConfigError(f"{str(folder)!r} is no ensemble")
    return EnsemblePolicy(policy.networks, weight=0.0)


def get_actor(
    module_dir: object, observation_space: Any, action_space: Any
) -> Callable[[Any, Any], Any]:
    """Returns the driver; it ignores the arguments."""
    del module_dir, observation_space, action_space
    policy = _plans()
    return lambda state, observation: state.drive(observation, policy.best)


def get_batch_actor(module_dir: object) -> Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]]:
    """Returns a function that drives several karts at once; it ignores the argument."""
    del module_dir
    policy = _plans()
    return lambda states, seen: type(states[0]).drive_together(states, seen, policy.best)
