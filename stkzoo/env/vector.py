"""Vector environments of single-agent races."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import gymnasium as gym
from gymnasium.vector import AsyncVectorEnv

from stkzoo._checks import check_type, check_whole
from stkzoo.config import AgentSpec
from stkzoo.engine.assets import find_assets
from stkzoo.env.gymnasium_api import split_keywords
from stkzoo.env.ids import MAX_EPISODE_STEPS, warn_of_time_limit
from stkzoo.env.options import use_known_karts
from stkzoo.env.vec.env import RaceVectorEnv
from stkzoo.env.vec.slots import is_of_fixed_size
from stkzoo.mdp.rewards import RewardOver


def single_kart_races(
    num_envs: int = 1,
    *,
    view: Any = "full",
    agent: AgentSpec | Mapping[str, object] | None = None,
    max_episode_steps: int | None = None,
    **options: Any,
) -> RaceVectorEnv:
    """Vector entry point of the Gymnasium ids, used by ``gym.make_vec``.

    Each race has one agent; the game drives the other karts. All races form one
    :class:`RaceVectorEnv` with the spaces of the id and one slot per race.

    Args:
        num_envs: number of races.
        view: the id's view; its spaces must have a fixed size.
        agent: options of the agent in every race.
        max_episode_steps: number of steps after which an episode is truncated, as in ``gym.make``;
            -1 for no limit. A smaller ``max_cycles`` holds.
        **options: keyword arguments of the id, options of its view, and ``prefetch``.

    Raises:
        ConfigError: an argument is invalid, or the view's spaces have no fixed size.
    """
    view, race = split_keywords(view, options, ("agent", "prefetch"))
    race["reward"] = RewardOver("reference", race.get("reward"))
    limit = MAX_EPISODE_STEPS if max_episode_steps is None else max_episode_steps
    max_cycles = race.setdefault("max_cycles", None)
    if limit != -1:
        limit = check_whole("max_episode_steps", limit, 1)
        max_cycles = limit if max_cycles is None else check_whole("max_cycles", max_cycles, 1)
        warn_of_time_limit(max_cycles, limit)
        race["max_cycles"] = min(limit, max_cycles)
    spec = AgentSpec() if agent is None else AgentSpec.of(agent)
    use_known_karts([spec], find_assets().karts)
    return RaceVectorEnv(num_envs, view=view, agents=[spec], **race)


def make_stkrace_vec(
    num_envs: int,
    env_id: str = "supertuxkart/simple-v0",
    env_kwargs: Mapping[str, Any] | None = None,
    context: str | None = "spawn",
    shared_memory: bool | None = None,
    **vec_kwargs: Any,
) -> AsyncVectorEnv:
    """Makes an ``AsyncVectorEnv`` of single-agent races, one worker process per race.

    Args:
        num_envs: number of races.
        env_id: a registered environment id.
        env_kwargs: keyword arguments of the environment.
        context: start method of the workers: ``"spawn"``, ``"forkserver"`` or ``"fork"``.
        shared_memory: whether observations pass through shared memory; ``None`` enables it if the
            observation space has a fixed size.
        **vec_kwargs: other keyword arguments of :class:`gymnasium.vector.AsyncVectorEnv`.

    Raises:
        ConfigError: an argument is invalid.
    """
    check_whole("num_envs", num_envs, 1)
    check_type("env_kwargs", env_kwargs, Mapping | None, "a dict of keyword arguments")
    make = partial(_make, env_id, dict(env_kwargs or {}))
    if shared_memory is None:
        with make() as env:
            shared_memory = is_of_fixed_size(env.observation_space)
    return AsyncVectorEnv(
        [make] * num_envs, context=context, shared_memory=bool(shared_memory), **vec_kwargs
    )


def _make(env_id: str, env_kwargs: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """Makes an environment in a worker; importing this module there registers the ids."""
    return gym.make(env_id, **env_kwargs)
