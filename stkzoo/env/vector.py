"""Many single-kart races side by side."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv

from stkzoo.config import AgentSpec
from stkzoo.env.gymnasium_api import split_keywords
from stkzoo.env.vec.env import RaceVectorEnv, is_of_fixed_size
from stkzoo.errors import check_whole, unknown_name
from stkzoo.mdp.rewards import RewardOver


def single_kart_races(
    num_envs: int = 1,
    *,
    view: Any = "full",
    agent: AgentSpec | Mapping[str, object] | None = None,
    max_episode_steps: int | None = None,
    max_cycles: int | None = None,
    **options: Any,
) -> RaceVectorEnv:
    """What ``gym.make_vec(id, vectorization_mode="vector_entry_point")`` makes of an id.

    Races of one agent and the game's own karts, in one :class:`RaceVectorEnv`, so with the
    id's spaces and a slot for each race.

    Args:
        num_envs: number of races.
        view: the id's view, of fixed size.
        agent: every race's agent.
        max_episode_steps: truncates, as the id's ``TimeLimit`` does.
        max_cycles: truncates as well; the smaller one counts.
        **options: keywords of the id, options of its view, and ``prefetch``.

    Raises:
        ConfigError: an argument is invalid, or the view's values differ in size.
    """
    view, race = split_keywords(view, options, ("agent", "prefetch"))
    race["reward"] = RewardOver("reference", race.get("reward"))
    limits = [limit for limit in (max_episode_steps, max_cycles) if limit not in (None, -1)]
    return RaceVectorEnv(
        num_envs,
        view=view,
        agents=[AgentSpec() if agent is None else AgentSpec.of(agent)],
        max_cycles=min(limits) if limits else None,
        **race,
    )


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
    check_whole("num_envs", num_envs, 1)
    known = [*inspect.signature(make_stkrace_vec).parameters]
    known = [*known[:-1], *inspect.signature(AsyncVectorEnv).parameters]
    for name in vec_kwargs:
        if name not in known:
            raise unknown_name("argument", name, known)
    make = partial(_make, env_id, dict(env_kwargs or {}))
    if shared_memory is None:
        with make() as env:
            shared_memory = is_of_fixed_size(env.observation_space)
    return AsyncVectorEnv(
        [make] * num_envs, context=context, shared_memory=bool(shared_memory), **vec_kwargs
    )


def _make(env_id: str, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Registers the ids in a worker too, because it belongs to stkzoo."""
    return gym.make(env_id, **env_kwargs)
