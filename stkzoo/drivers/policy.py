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
    """Returns the policy itself; for a Stable-Baselines3 algorithm, its ``policy``.

    Raises:
        ConfigError: the argument is not a policy.
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
    """Returns a copy of a policy, which later learning does not change.

    Raises:
        ConfigError: the argument is not a policy, or cannot be copied.
    """
    policy = plain_policy(policy)
    with suppress(Exception):  # a PPO policy that has learned contains an autograd graph
        return copy.deepcopy(policy)
    try:
        return pickle.loads(pickle.dumps(policy))  # noqa: S301 - pickled here
    except Exception as error:
        raise ConfigError(
            f"the policy {shortened(policy, 200)} cannot be copied ({error}); give a function "
            "from an observation to an action that needs nothing that still learns"
        ) from error


class PolicyActor:
    """An actor that applies a stateless policy to one kart.

    Args:
        policy: policy from :func:`plain_policy`.
        observation_space: space of the kart's observations.
    """

    def __init__(self, policy: Any, observation_space: spaces.Space[Any], *_: object) -> None:
        self.policy, self.observation_space = policy, observation_space

    def __call__(self, observation: Any) -> Any:
        """Returns the action for an observation."""
        if hasattr(self.policy, "predict"):
            return act_together([self], [observation])[0]
        return self.policy(observation)

    def __deepcopy__(self, _: dict[int, Any]) -> PolicyActor:
        return self


def act_together(actors: Sequence[Actor], observations: Sequence[Any]) -> Sequence[Any]:
    """Returns the deterministic actions of several karts with one call of ``predict``.

    Args:
        actors: :class:`PolicyActor` objects with the same policy and view.
        observations: one observation per actor.
    """
    actor: Any = actors[0]
    seen, wanted = actor.observation_space, getattr(actor.policy, "observation_space", None)
    if isinstance(seen, spaces.Dict) and isinstance(wanted, spaces.Box):  # SB3 flat_observations
        flat: list[Any] = [spaces.flatten(seen, own) for own in observations]
        batch: Any = np.stack(flat).astype(wanted.dtype)
    elif isinstance(seen, spaces.Dict):
        batch = {key: np.stack([own[key] for own in observations]) for key in seen.spaces}
    else:
        batch = np.stack(observations)
    actions, _ = actor.policy.predict(batch, deterministic=True)
    return list(actions)
