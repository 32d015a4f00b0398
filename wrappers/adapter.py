"""Applies single-agent wrappers to the agents of a multi-agent environment."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NoReturn

import gymnasium as gym
from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

from stkzoo._checks import unknown_name
from stkzoo.agent_names import of_agent, require_actions
from stkzoo.errors import ConfigError
from stkzoo.views.agent_chain import WrapperMemory
from stkzoo.views.walker import ChainWalker, Factories, StepParts


class MonoAgentWrapperAdapter:
    """Gives each agent of an environment its own wrappers.

    Around a Gymnasium environment with ``Dict`` spaces by agent (``supertuxkart/multi-full-v0``),
    the result is a Gymnasium wrapper, :class:`GymAgentAdapter`. Around a PettingZoo
    ``ParallelEnv``, it is a ``ParallelEnv``, :class:`ParallelAgentAdapter`. Any Gymnasium wrapper
    works, including those with their own ``step`` or ``reset``. Wrappers are reset with the race,
    and their changes to rewards, ends and infos apply to their agent. An instance of a subclass has
    the form for its environment, too.

    Args:
        env: the multi-agent environment.
        wrapper_factories: views by agent. Agents are keys by id, number or number as a string. A
            view is a name (``stkzoo.views()``), a function that wraps the agent's environment, or a
            pair of either and its options, such as ``("simple", {"state_items": 3})``. Agents that
            are missing or ``None`` have no wrappers.
        keep_original: also return copies of the unwrapped observations. The Gymnasium form adds
            ``original/<agent>`` to the observations. In the ``ParallelEnv`` form, each observation
            and its space become ``{"observation": wrapped, "original": unwrapped}``.

    Raises:
        ConfigError: ``env`` is neither kind of environment, an agent does not exist, or a view is
            unknown or rejects its environment or options.
        AgentException: a factory or, later, a wrapper failed; ``key`` names the agent.
    """

    def __new__(
        cls, env: Any = None, wrapper_factories: Any = None, *_: Any, **options: Any
    ) -> MonoAgentWrapperAdapter:
        """Selects the class for the kind of environment; subclasses may have other arguments."""
        if issubclass(cls, (GymAgentAdapter, ParallelAgentAdapter)):
            return super().__new__(cls)
        if cls is not MonoAgentWrapperAdapter:
            is_parallel = isinstance(env, ParallelEnv)
            return _blank(ParallelAgentAdapter if is_parallel else GymAgentAdapter, cls)
        for name in options.keys() - {"keep_original"}:
            known = ("env", "wrapper_factories", "keep_original")
            raise unknown_name("argument", name, known)
        if not isinstance(wrapper_factories, Mapping):
            raise ConfigError(
                'wrapper_factories has to be a mapping from agents to views, such as {"0": '
                f'"simple"}}, but is {wrapper_factories!r:.200}'
            )
        if isinstance(env, ParallelEnv):
            return super().__new__(ParallelAgentAdapter)
        if isinstance(env, gym.Env):
            return super().__new__(GymAgentAdapter)
        raise ConfigError(
            f"MonoAgentWrapperAdapter wraps a ParallelEnv or a gymnasium.Env, not {env!r}."
        )

    keep_original = False

    def __init__(
        self, env: Any, wrapper_factories: Factories, *, keep_original: bool = False
    ) -> None: ...

    def _copies(self, observations: Mapping[str, Any]) -> dict[str, Any]:
        """Returns copies of unwrapped observations if requested; call it before wrappers run."""
        return copy.deepcopy(dict(observations)) if self.keep_original else {}


class GymAgentAdapter(
    MonoAgentWrapperAdapter, gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs
):
    """:class:`MonoAgentWrapperAdapter` around a Gymnasium environment.

    If the environment provides ``info["reward"]`` and ``info["terminated"]`` by agent, the wrappers
    see them as their agent's reward and end. The wrapped values replace them, as well as
    ``info["truncated"]`` and ``info["infos"]``, and the scalar reward changes by the sum of the
    differences. Agents that are missing in a step's observations or actions are skipped.
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        wrapper_factories: Factories,
        *,
        keep_original: bool = False,
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(
            self,
            _disable_deepcopy=True,  # a factory may be a method of a large or uncopyable object
            keep_original=bool(keep_original),
            wrapper_factories=dict(wrapper_factories),
        )
        gym.Wrapper.__init__(self, env)
        self.keep_original = bool(keep_original)
        originals = _spaces_by_agent(env.observation_space)
        self._walker = ChainWalker(originals, _spaces_by_agent(env.action_space), wrapper_factories)
        self._present: tuple[str, ...] = ()
        self.action_space = spaces.Dict(self._walker.action_spaces)
        kept = self._handed_out(originals)
        self.observation_space = spaces.Dict({**self._walker.observation_spaces, **kept})

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Resets the environment and all wrappers."""
        observations, info = self.env.reset(seed=seed, options=options)
        options = _with_step_size(options, self.env)
        originals = self._handed_out(observations)
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
        require_actions(actions, self._present, optional=self._present)
        checked = self._walker.read_actions(actions, self._present)
        base = self._walker.begin_step(checked, self._present)
        try:
            observations, reward, terminated, truncated, info = self.env.step(base)
            originals = self._handed_out(observations)
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

    def _handed_out(self, by_agent: Mapping[str, Any]) -> dict[str, Any]:
        """Returns copies of unwrapped observations if requested; call it before wrappers run."""
        copies = self._copies(self._known(by_agent))
        return {f"original/{agent}": value for agent, value in copies.items()}


@dataclass(frozen=True, slots=True)
class _AdapterMoment:
    """State of an adapter: the memory of its wrappers by agent, and the agents that have left."""

    wrappers: Mapping[str, WrapperMemory]
    retired: frozenset[str]


class ParallelAgentAdapter(MonoAgentWrapperAdapter, BaseParallelWrapper[str, Any, Any]):
    """:class:`MonoAgentWrapperAdapter` around a PettingZoo ``ParallelEnv``.

    An agent whose wrapper ends its episode early leaves ``agents``; its kart stays in the race with
    an action of zeros. Around a race, saved states include the attributes of the wrappers. For
    clones, use views instead: ``race_v0.parallel_env(view=wrapper_factories)``.
    """

    def __init__(
        self,
        env: ParallelEnv[str, Any, Any],
        wrapper_factories: Factories,
        *,
        keep_original: bool = False,
    ) -> None:
        BaseParallelWrapper.__init__(self, env)
        self.keep_original = bool(keep_original)
        self._retired: frozenset[str] = frozenset()
        agents = env.possible_agents
        self._walker = ChainWalker(
            {agent: env.observation_space(agent) for agent in agents},
            {agent: env.action_space(agent) for agent in agents},
            wrapper_factories,
        )
        self._observation_spaces = self._walker.observation_spaces
        if self.keep_original:
            originals = self._copies({agent: env.observation_space(agent) for agent in agents})
            both = self._with_originals(self._observation_spaces, originals)
            self._observation_spaces = {agent: spaces.Dict(parts) for agent, parts in both.items()}

    @property
    def agents(self) -> list[str]:
        """Agents whose episode has not ended."""
        return [agent for agent in self.env.agents if agent not in self._retired]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Returns the agent's wrapped observation space, the same object on every call."""
        return of_agent(self._observation_spaces, agent)

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
        originals = self._copies(observations)
        observations, infos = dict(observations), dict(infos)
        self._walker.reset(tuple(observations), observations, infos, seed, options)
        return self._with_originals(observations, originals), infos

    def step(self, actions: dict[str, Any]) -> StepParts:
        """Converts the agents' actions, steps the environment and wraps the results.

        Raises:
            ActionError: an action is missing or invalid; neither the environment nor a wrapper has
                changed.
        """
        agents = self.agents
        if not agents:
            return {}, {}, {}, {}, {}
        # The actions of agents that the game drives are optional in a race.
        require_actions(actions, agents, getattr(self.env.unwrapped, "ai_agents", ()))
        base = self._walker.begin_step(self._walker.read_actions(actions, agents), agents)
        for agent in self._retired.intersection(self.env.agents):
            base[agent] = create_zero_array(self.env.action_space(agent))
        try:
            results = self.env.step(base)
            originals = self._copies(results[0])
            present = [agent for agent in agents if agent in results[0]]
            parts: Any = tuple({agent: part[agent] for agent in present} for part in results)
            self._walker.finish_step(present, parts)
        finally:
            self._walker.abandon()
        observations, rewards, terminations, truncations, infos = parts
        self._retired |= {agent for agent in present if terminations[agent] or truncations[agent]}
        observations = self._with_originals(observations, originals)
        return observations, rewards, terminations, truncations, infos

    def save_state(self) -> Any:
        """Saves the current moment of the race and of the wrappers.

        See :meth:`~stkzoo.env.parallel.RaceParallelEnv.save_state`.

        Raises:
            AgentException: a wrapper holds an object that cannot be copied.
        """
        wrappers = {agent: chain.memory() for agent, chain in self._walker.chains.items()}
        state = self._race_method("save_state")()
        state.front = (*(state.front or ()), _AdapterMoment(wrappers, self._retired))
        return state

    def restore_state(self, state: Any) -> None:
        """Continues from a saved state, with the race and the wrappers as they were.

        See :meth:`~stkzoo.env.parallel.RaceParallelEnv.restore_state`.

        Args:
            state: a state from :meth:`save_state` of this adapter or of an equal one.

        Raises:
            AgentException: the state is of other wrappers.
            ConfigError: the state was saved without the adapter.
        """
        front, depth = getattr(state, "front", None), _num_adapters(self.env)
        moments = front if isinstance(front, tuple) else ()
        if len(moments) <= depth or not isinstance(moments[depth], _AdapterMoment):
            raise ConfigError(
                f"state is {state!r:.200}, expected one that save_state() of this adapter "
                "returned, with the memory of its wrappers"
            )
        moment, chains = moments[depth], self._walker.chains
        if moment.wrappers.keys() != chains.keys():
            raise ConfigError(
                f"the state is of agents {', '.join(moment.wrappers)}, this environment has "
                f"{', '.join(chains)}"
            )
        for agent, chain in chains.items():
            chain.check_memory(moment.wrappers[agent])
        self._race_method("restore_state")(state)
        for agent, chain in chains.items():
            chain.recall(moment.wrappers[agent])
        self._retired = moment.retired

    def clone(self, *_: object) -> NoReturn:
        """Raises ``ConfigError``, as ``lookahead`` and ``follow`` do.

        A clone would lack the wrappers, and the wrappers would not follow another environment.
        """
        raise ConfigError(
            "clone(), lookahead() and follow() do not work around MonoAgentWrapperAdapter, whose "
            "wrappers belong to one environment; make the race with view=wrapper_factories "
            "instead, or use those of the race without these wrappers, its unwrapped"
        )

    lookahead = follow = clone

    def _race_method(self, name: str) -> Any:
        method = getattr(self.env, name, None)
        if method is None:
            raise ConfigError(f"{name}() needs an environment with saved states, not {self.env!r}")
        return method

    def close(self) -> None:
        """Closes all wrappers and the environment."""
        self._walker.close()
        super().close()

    def _with_originals(
        self, changed: dict[str, Any], originals: Mapping[str, Any]
    ) -> dict[str, Any]:
        if not self.keep_original:
            return changed
        return {
            agent: {"observation": observation, "original": originals[agent]}
            for agent, observation in changed.items()
        }


def _num_adapters(env: Any) -> int:
    """Returns the number of adapters in an environment."""
    count = 0
    while isinstance(env, BaseParallelWrapper):
        count += isinstance(env, ParallelAgentAdapter)
        env = env.env
    return count


#: The result of :func:`_subclass_in` for each pair of arguments.
_SUBCLASSES: dict[tuple[type[Any], type[Any]], type[Any]] = {}


def _subclass_in(form: type[Any], kind: type[Any]) -> type[Any]:
    """Returns a subclass of the adapter, ``kind``, in the form for an environment."""
    if (form, kind) in _SUBCLASSES:
        return _SUBCLASSES[form, kind]
    own: dict[str, Any] = {
        name: getattr(kind, name) for name in ("__doc__", "__module__", "__qualname__")
    }
    own["__reduce__"] = lambda adapter: (_blank, (form, kind), vars(adapter))
    return _SUBCLASSES.setdefault((form, kind), type(kind.__name__, (kind, form), own))


def _blank(form: type[Any], kind: type[Any]) -> MonoAgentWrapperAdapter:
    """Returns a new adapter of a subclass, without attributes."""
    made: MonoAgentWrapperAdapter = object.__new__(_subclass_in(form, kind))
    return made


def _with_step_size(options: Mapping[str, Any] | None, env: Any) -> dict[str, Any] | None:
    """Returns the options of ``reset`` for wrappers, with the race's step size, as in views."""
    race = getattr(env.unwrapped, "core", env.unwrapped)
    step_size = getattr(race, "step_size", None)
    if step_size is None:
        return None if options is None else dict(options)
    return {**(options or {}), "step_size": step_size}


def _spaces_by_agent(space: spaces.Space[Any]) -> dict[str, spaces.Space[Any]]:
    if not isinstance(space, spaces.Dict):
        raise ConfigError(f"expected a Dict space by agent, found {space!r:.200}")
    return dict(space.spaces)


def _parts_by_agent(
    observations: dict[str, Any], info: Mapping[str, Any], terminated: bool, truncated: bool
) -> StepParts:
    """Splits the result of a Gymnasium multi-agent step by agent."""
    rewards, ends, cuts, infos = (
        info.get(key, {}) for key in ("reward", "terminated", "truncated", "infos")
    )
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
    _, rewards, terminations, truncations, infos = parts
    own: dict[str, Mapping[str, Any]] = {
        "reward": rewards,
        "terminated": terminations,
        "truncated": truncations,
        "infos": infos,
    }
    for key, part in own.items():
        if key in info or (key == "truncated" and "terminated" in info):
            changed[key] = {**info.get(key, {}), **part}
    if "done" in info:
        changed["done"] = {agent: end or truncations[agent] for agent, end in terminations.items()}
    return changed
