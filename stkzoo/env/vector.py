"""Many single-kart races side by side."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from gymnasium.vector import AsyncVectorEnv

from stkzoo.errors import ConfigError

__all__ = ["make_stkrace_vec"]


def make_stkrace_vec(
    num_envs: int,
    env_id: str = "supertuxkart/simple-v0",
    env_kwargs: Mapping[str, Any] | None = None,
    context: str | None = "spawn",
    shared_memory: bool | None = None,
    **vec_kwargs: Any,
) -> AsyncVectorEnv:
    """Races of one agent each, every one in a worker process of its own.

    Args:
        num_envs: number of races.
        env_id: a registered id.
        env_kwargs: keywords of the environment.
        context: how workers are started: ``"spawn"``, ``"forkserver"`` or ``"fork"``.
        shared_memory: pass observations through shared memory; by default where their
            space allows it.
        **vec_kwargs: further keywords of :class:`gymnasium.vector.AsyncVectorEnv`.
    """
    if not isinstance(num_envs, int) or num_envs < 1:
        raise ConfigError(f"num_envs is {num_envs!r}, expected a whole number of 1 or more")
    make = partial(_make, env_id, dict(env_kwargs or {}))
    if shared_memory is None:
        with make() as env:
            vec_kwargs["shared_memory"] = not _varies_in_size(env.observation_space)
    else:
        vec_kwargs["shared_memory"] = shared_memory
    return AsyncVectorEnv([make] * num_envs, context=context, **vec_kwargs)


def _make(env_id: str, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    return gym.make(env_id, **env_kwargs)


def _varies_in_size(space: spaces.Space[Any]) -> bool:
    if isinstance(space, (spaces.Sequence, spaces.Graph)):
        return True
    if isinstance(space, spaces.Dict):
        return any(map(_varies_in_size, space.spaces.values()))
    return False
