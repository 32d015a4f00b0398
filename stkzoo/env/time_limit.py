"""How the ``TimeLimit`` of Gymnasium ids follows ``max_cycles``."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import EnvSpec
from gymnasium.wrappers import TimeLimit


class RaceSpec(EnvSpec):
    """A spec in which ``max_cycles``, if given, replaces the time limit of the id."""

    @classmethod
    def of(cls, spec: EnvSpec) -> RaceSpec:
        """Returns a spec with the same fields."""
        return cls(
            **{field.name: getattr(spec, field.name) for field in fields(spec) if field.init}
        )

    @property
    def max_episode_steps(self) -> int | None:
        """Number of steps after which an episode is truncated; ``None`` for no limit."""
        is_of_id = self._limit in (None, limit_of_id(self))
        limit: int | None = self.kwargs.get("max_cycles", self._limit) if is_of_id else self._limit
        return limit

    @max_episode_steps.setter
    def max_episode_steps(self, limit: int | None) -> None:
        self._limit = limit


def limit_of_id(spec: EnvSpec) -> int | None:
    """Returns the time limit with which the id of a spec is registered, if there is one."""
    registered = gym.registry.get(spec.id)
    return registered.max_episode_steps if registered else None


def follow_max_cycles(
    env: gym.Env[Any, Any], has_max_cycles: bool, asked: Mapping[str, Any]
) -> None:
    """Disables the ``TimeLimit`` of an environment for an episode that has its own ``max_cycles``.

    ``gym.make`` adds the wrapper outside the environment, which cannot refer to it. So it is looked
    up among the callers: this function must be called by ``reset``.

    Args:
        env: the environment.
        has_max_cycles: whether the environment was created with ``max_cycles``, which replaces the
            limit of its id. A limit that the user gave to ``gym.make`` stays.
        asked: options of ``reset``; ``max_cycles`` replaces any limit.
    """
    if env.spec is None:
        return
    frame = inspect.currentframe()
    while frame is not None:
        caller = frame.f_locals.get("self")
        if isinstance(caller, TimeLimit) and caller.unwrapped is env:
            limit = caller._max_episode_steps
            if "max_cycles" in asked or (has_max_cycles and limit == limit_of_id(env.spec)):
                caller._elapsed_steps = -sys.maxsize  # type: ignore[assignment]
            return
        frame = frame.f_back
