"""Policies as drivers: functions, and objects with Stable-Baselines3's ``predict``."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.drivers.code import Actor
from stkzoo.errors import ConfigError, shortened


def plain_policy(policy: object) -> Any:
    """What picks the actions: of an algorithm of Stable-Baselines3, its policy.

    Raises:
        ConfigError: it is no policy.
    """
    if hasattr(policy, "predict") and not isinstance(policy, type):
        return getattr(policy, "policy", policy)
    if callable(policy) and not isinstance(policy, type):
        return policy
    raise ConfigError(
        f"a policy is {shortened(policy, 200)}, expected a function from an observation to an "
        "action, or an object with Stable-Baselines3's predict"
    )


def frozen_policy(policy: object) -> Any:
    """A copy of a policy, which does not learn.

    Raises:
        ConfigError: it is no policy, or cannot be copied.
    """
    policy = plain_policy(policy)
    with suppress(Exception):  # that of PPO has a graph in it once it has learned
        return copy.deepcopy(policy)
    try:
        return pickle.loads(pickle.dumps(policy))  # noqa: S301 - just made
    except Exception as error:
        raise ConfigError(
            f"the policy {shortened(policy, 200)} cannot be copied ({error}); give a function "
            "from an observation to an action that needs nothing that still learns"
        ) from error


class PolicyActor:
    """One kart's actor by a policy, which remembers nothing.

    Args:
        policy: what :func:`plain_policy` gave.
        observation_space: what the kart sees.
    """

    def __init__(self, policy: Any, observation_space: spaces.Space[Any], *_: object) -> None:
        self.policy, self.observation_space = policy, observation_space

    def __call__(self, observation: Any) -> Any:
        """The action for an observation."""
        if hasattr(self.policy, "predict"):
            return act_together([self], [observation])[0]
        return self.policy(observation)

    def __deepcopy__(self, _: dict[int, Any]) -> PolicyActor:
        return self


def act_together(actors: Sequence[Actor], observations: Sequence[Any]) -> Sequence[Any]:
    """The likeliest actions of several karts by one ``predict``.

    Args:
        actors: of the type :class:`PolicyActor`, all of one policy and view.
        observations: one for each.
    """
    actor: Any = actors[0]
    seen, wanted = actor.observation_space, getattr(actor.policy, "observation_space", None)
    if isinstance(seen, spaces.Dict) and isinstance(wanted, spaces.Box):  # flat_observations
        flat: list[Any] = [spaces.flatten(seen, own) for own in observations]
        batch: Any = np.stack(flat).astype(wanted.dtype)
    elif isinstance(seen, spaces.Dict):
        batch = {key: np.stack([own[key] for own in observations]) for key in seen.spaces}
    else:
        batch = np.stack(observations)
    actions, _ = actor.policy.predict(batch, deterministic=True)
    return list(actions)
