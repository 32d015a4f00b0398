"""Applies single-agent wrappers to the agents of a multi-agent environment."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, ClassVar, NoReturn, cast

import gymnasium as gym
from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo._checks import check_arguments, check_type, shortened
from stkzoo._left_out import LeftOutNames
from stkzoo.agent_names import actions_by_agent, of_agent
from stkzoo.errors import ConfigError
from stkzoo.views.walker import ChainWalker, Factories, StepParts


@check_arguments
class MonoAgentWrapperAdapter(
    gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs, LeftOutNames
):
    """Gives each agent of an environment its own wrappers.

    Around a Gymnasium environment with ``Dict`` spaces by agent (``supertuxkart/multi-full-v0``),
    this is a Gymnasium wrapper. Around a PettingZoo ``ParallelEnv``, the call returns a
    ``ParallelEnv``, :class:`ParallelAgentAdapter`. Any Gymnasium wrapper works, including those
    with their own ``step`` or ``reset``. Wrappers are reset with the race, and their changes to
    rewards, ends and infos apply to their agent.

    If the Gymnasium environment provides ``info["reward"]`` and ``info["terminated"]`` by agent,
    the wrappers see them as their agent's reward and end. The wrapped values replace them, as well
    as ``info["truncated"]`` and ``info["infos"]``, and the scalar reward changes by the sum of the
    differences. Agents that are missing in a step's observations or actions are skipped.

    Args:
        env: the multi-agent environment.
        wrapper_factories: views by agent. Agents are keys by id, number or number as a string. A
            view is a name (``stkzoo.views()``), a function that wraps the agent's environment, or a
            pair of either and its options, such as ``("simple", {"state_items": 3})``. Agents that
            are missing or ``None`` have no wrappers.
        keep_original: also return copies of the unwrapped observations, as the entries
            ``original/<agent>`` of the observations. Only around a Gymnasium environment.

    Raises:
        ConfigError: ``env`` is neither kind of environment, an agent does not exist, or a view is
            unknown or rejects its environment or options.
        AgentException: a factory or, later, a wrapper failed; ``key`` names the agent.
    """

    left_out: ClassVar = dict.fromkeys(
        ("action", "observation", "keys", "mono_envs", "wrappers"), "use step and action_space"
    )

    def __new__(cls, env: Any = None, *arguments: Any, **options: Any) -> Any:
        """Returns a :class:`ParallelAgentAdapter` around a ``ParallelEnv``."""
        if cls is MonoAgentWrapperAdapter and isinstance(env, ParallelEnv):
            return ParallelAgentAdapter(env, *arguments, **options)
        return super().__new__(cls)

    def __init__(
        self,
        env: gym.Env[Any, Any],
        wrapper_factories: Factories,
        *,
        keep_original: bool = False,
    ) -> None:
        if not isinstance(env, gym.Env):
            raise ConfigError(
                f"env is {env!r}, expected a gymnasium.Env or, without a subclass, a ParallelEnv"
            )
        gym.utils.RecordConstructorArgs.__init__(
            self,
            _disable_deepcopy=True,  # a factory may be a method of a large or uncopyable object
            keep_original=bool(keep_original),
            wrapper_factories=_checked_factories(wrapper_factories),
        )
        gym.Wrapper.__init__(self, env)
        self.keep_original = bool(keep_original)
        originals = _spaces_by_agent(env.observation_space)
        self._walker = ChainWalker(originals, _spaces_by_agent(env.action_space), wrapper_factories)
        self._present: tuple[str, ...] = ()
        self.action_space = spaces.Dict(self._walker.action_spaces)
        kept = self._originals(originals)
        self.observation_space = spaces.Dict({**self._walker.observation_spaces, **kept})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Resets the environment and all wrappers."""
        observations, info = self.env.reset(seed=seed, options=options)
        options = _with_step_size(options, self.env)
        originals = self._originals(observations)
        changed, infos = self._known(observations), dict(info.get("infos", {}))
        self._present = tuple(changed)
        self._walker.reset(self._present, changed, infos, seed, options)
        info = {**info, "infos": infos} if "infos" in info else dict(info)
        return {**changed, **originals}, info

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Converts the agents' actions, steps the environment and wraps the results.

        Raises:
            ActionError: an action is missing or invalid; the environment has not changed. Nor have
                the wrappers if an action is invalid.
        """
        actions = actions_by_agent(actions, self._present, optional=self._present)
        checked = self._walker.read_actions(actions, self._present)
        base = self._walker.begin_step(checked, self._present)
        try:
            observations, reward, terminated, truncated, info = self.env.step(base)
            originals = self._originals(observations)
            parts = _parts_by_agent(self._known(observations), info, terminated, truncated)
            changed, rewards, terminations, truncations, _ = parts
            unchanged = dict(rewards)
            self._walker.finish_step(tuple(changed), parts)
        finally:
            self._walker.abandon()
        self._present = tuple(changed)
        ends = [terminations[agent] or truncations[agent] for agent in changed]
        if "terminated" in info and ends and all(ends) and not (terminated or truncated):
            terminated = all(terminations.values())
            truncated = not terminated
        return (
            {**changed, **originals},
            float(reward) + sum(rewards[agent] - unchanged[agent] for agent in rewards),
            bool(terminated),
            bool(truncated),
            _changed_info(info, parts),
        )

    def close(self) -> None:
        """Closes all wrappers and the environment."""
        self._walker.close()
        super().close()

    def _known(self, observations: Mapping[str, Any]) -> dict[str, Any]:
        return {
            agent: observations[agent] for agent in observations if agent in self._walker.chains
        }

    def _originals(self, by_agent: Mapping[str, Any]) -> dict[str, Any]:
        """Returns copies of unwrapped observations if requested; call it before wrappers run."""
        if not self.keep_original:
            return {}
        return {f"original/{a}": copy.deepcopy(seen) for a, seen in self._known(by_agent).items()}


@check_arguments
class ParallelAgentAdapter(BaseParallelWrapper[str, Any, Any]):
    """:class:`MonoAgentWrapperAdapter` around a PettingZoo ``ParallelEnv``.

    An agent whose wrapper ends its episode early leaves ``agents``; its kart stays in the race with
    an action of zeros. For saved states and clones, use views instead:
    ``race_v0.parallel_env(view=wrapper_factories)``.

    Args:
        env: the environment.
        wrapper_factories: see :class:`MonoAgentWrapperAdapter`.

    Raises:
        ConfigError: see :class:`MonoAgentWrapperAdapter`; likewise ``AgentException``.
    """

    def __init__(self, env: ParallelEnv[str, Any, Any], wrapper_factories: Factories) -> None:
        super().__init__(env)
        self._retired: frozenset[str] = frozenset()
        agents = env.possible_agents
        self._walker = ChainWalker(
            {agent: env.observation_space(agent) for agent in agents},
            {agent: env.action_space(agent) for agent in agents},
            _checked_factories(wrapper_factories),
        )

    @property
    def agents(self) -> list[str]:
        """Agents whose episode has not ended."""
        return [agent for agent in self.env.agents if agent not in self._retired]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's wrapped observation space, the same object on every call."""
        return of_agent(self._walker.observation_spaces, agent)

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's wrapped action space, the same object on every call."""
        return of_agent(self._walker.action_spaces, agent)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Resets the environment and all wrappers."""
        observations, infos = self.env.reset(seed=seed, options=options)
        options = _with_step_size(options, self.env)
        self._retired = frozenset()
        observations, infos = dict(observations), dict(infos)
        self._walker.reset(tuple(observations), observations, infos, seed, options)
        return observations, infos

    def step(self, actions: dict[str, Any]) -> StepParts:
        """Converts the agents' actions, steps the environment and wraps the results.

        Raises:
            ActionError: an action is missing or invalid; neither the environment nor a wrapper has
                changed.
        """
        agents = self.agents
        if not agents:
            return ({}, {}, {}, {}, {}) if self._retired else self.env.step({})
        # The actions of agents that the game drives are optional in a race.
        actions = actions_by_agent(actions, agents, getattr(self.env.unwrapped, "ai_agents", ()))
        base = self._walker.begin_step(self._walker.read_actions(actions, agents), agents)
        for agent in self._retired.intersection(self.env.agents):
            base[agent] = create_zero_array(self.env.action_space(agent))
        try:
            results = self.env.step(base)
            present = [agent for agent in agents if agent in results[0]]
            by_part: Any = tuple({agent: part[agent] for agent in present} for part in results)
            parts: StepParts = by_part
            self._walker.finish_step(present, parts)
        finally:
            self._walker.abandon()
        _, _, terminations, truncations, _ = parts
        self._retired |= {agent for agent in present if terminations[agent] or truncations[agent]}
        return parts

    def save_state(self, *_: object) -> NoReturn:
        """Raises ``ConfigError``, as do the other methods for saved states and clones.

        A state or clone of the race would lack the wrappers.
        """
        raise ConfigError(
            "saved states and clones of the race lack the wrappers of MonoAgentWrapperAdapter; "
            "make the race with view=wrapper_factories instead, or use those of its unwrapped"
        )

    restore_state = clone = lookahead = follow = save_state

    def close(self) -> None:
        """Closes all wrappers and the environment."""
        self._walker.close()
        super().close()


def _checked_factories(factories: object) -> dict[Any, Any]:
    expected = 'a mapping from agents to views, such as {"0": "simple"}'
    return dict(check_type("wrapper_factories", factories, Mapping, expected))


def _with_step_size(options: Mapping[str, Any] | None, env: Any) -> dict[str, Any] | None:
    """Returns the options of ``reset`` for wrappers, with the race's step size, as in views."""
    race = getattr(env.unwrapped, "core", env.unwrapped)
    step_size = getattr(race, "step_size", None)
    if step_size is None:
        return None if options is None else dict(options)
    return {**(options or {}), "step_size": step_size}


def _spaces_by_agent(space: spaces.Space[Any]) -> dict[str, spaces.Space[Any]]:
    if not isinstance(space, spaces.Dict):
        raise ConfigError(f"expected a Dict space by agent, found {shortened(space)}")
    return dict(space.spaces)


#: Entries by agent in the info of a Gymnasium multi-agent step, in the order of :data:`StepParts`.
_BY_AGENT = ("reward", "terminated", "truncated", "infos")


def _parts_by_agent(
    observations: dict[str, Any], info: Mapping[str, Any], terminated: bool, truncated: bool
) -> StepParts:
    """Splits the result of a Gymnasium multi-agent step by agent."""
    rewards, ends, cuts, infos = (info.get(key, {}) for key in _BY_AGENT)
    terminations = {agent: bool(ends.get(agent, terminated)) for agent in observations}
    return (
        observations,
        {agent: float(rewards.get(agent, 0.0)) for agent in observations},
        terminations,
        {a: bool(cuts.get(a, truncated and not terminations[a])) for a in observations},
        {agent: infos.get(agent, {}) for agent in observations},
    )


def _changed_info(info: Mapping[str, Any], parts: StepParts) -> dict[str, Any]:
    """Returns the info of a step with its entries by agent replaced, if it has them."""
    changed = dict(info)
    _, *by_agent = cast(tuple[dict[str, Any], ...], parts)
    for key, part in zip(_BY_AGENT, by_agent, strict=True):
        if key in info or (key == "truncated" and "terminated" in info):
            changed[key] = {**info.get(key, {}), **part}
    if "done" in info:
        _, _, terminations, truncations, _ = parts
        changed["done"] = {agent: end or truncations[agent] for agent, end in terminations.items()}
    return changed
