"""One agent's chain of wrappers, cut into the half before and the half after a race's step."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeAlias

import gymnasium as gym
from gymnasium import spaces

from stkzoo.errors import ActionError, AgentError, AgentException, ConfigError
from stkzoo.views.actions import clip_numbers, read_action
from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.views.plan import ViewPlan
from stkzoo.views.split_step import AgentStep, CompiledPart, MonoAgentEnv, SplitStep

#: Wraps one agent's environment; ``None`` leaves it as it is.
WrapperFactory: TypeAlias = Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]] | None

# Gymnasium's steps that do nothing but call `action`, `observation` or `reward`.
_ACTING = (gym.ActionWrapper.step, ActionObservationWrapper.step)
_OBSERVING = (gym.ObservationWrapper.step, ActionObservationWrapper.step)
_PLAIN_STEPS = (*_ACTING, *_OBSERVING, gym.RewardWrapper.step, gym.Wrapper.step)


@contextmanager
def agent_failures(
    agent: str, doing: str, refusals: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Turns any exception of an agent's wrappers, but refusals, into an ``AgentException``."""
    try:
        yield
    except (AgentError, ActionError):
        raise
    except refusals:
        raise
    except Exception as error:
        raise AgentException(
            f"the wrappers of agent {agent!r} failed to {doing}: {type(error).__name__}: {error}",
            agent,
        ) from error


@dataclass(frozen=True, slots=True)
class WrapperMemory:
    """The attributes of some objects at one moment, as copies.

    Attributes:
        owners: the objects.
        attributes: their attributes, in the same order. References to an owner lead to the
            owner itself, spaces are shared, and all else is a copy.
    """

    owners: tuple[Any, ...]
    attributes: list[dict[str, Any]]

    @classmethod
    def of(cls, owners: Sequence[Any]) -> WrapperMemory:
        """What some objects remember now.

        Raises:
            Exception: an attribute cannot be copied by :func:`copy.deepcopy`.
        """
        memo = {id(owner): owner for owner in owners}
        return cls(tuple(owners), copy.deepcopy([vars(o) for o in owners], memo | _spaces(owners)))

    def check(self, others: Sequence[Any]) -> None:
        """Checks that other objects can remember this.

        Raises:
            TypeError: they are of other classes.
        """
        here, there = ([type(o) for o in objects] for objects in (self.owners, others))
        if here != there:
            raise TypeError(f"they are {_names(there)}; the state's were {_names(here)}")

    def give_to(self, others: Sequence[Any]) -> None:
        """Makes other objects, or the same ones, remember this; their spaces stay theirs.

        Args:
            others: objects of the same classes in the same order (:meth:`check`).
        """
        memo: dict[int, Any] = dict(zip(map(id, self.owners), others, strict=True))
        for owner, other in zip(self.owners, others, strict=True):
            for name, value in vars(owner).items():
                if isinstance(value, spaces.Space):
                    memo[id(value)] = vars(other).get(name, value)
        copies = copy.deepcopy(self.attributes, memo)
        for other, attributes in zip(others, copies, strict=True):
            vars(other).clear()
            vars(other).update(attributes)


class AgentChain:
    """The wrappers around one agent, working on the single form.

    Attributes:
        agent: the agent's id.
        env: the outermost wrapper.
        observation_space: what the agent sees, after all wrappers.
        action_space: what the agent chooses from, before all wrappers.
        base_observation_space: the innermost observations.
        base_action_space: the innermost actions.
        num_clipped: how many actions had numbers outside a ``Box``, which were clipped; ``None``
            where those are errors.
        is_pure: whether the wrappers that run here are all pure functions of this package.

    Args:
        agent: the agent's id.
        observation_space: its observations without wrappers.
        action_space: its actions without wrappers.
        factory: wraps the agent's environment.
        is_strict: whether finite numbers outside a ``Box`` are errors.

    Raises:
        AgentException: the factory raised, or returned no wrapper of what it was given.
        ConfigError: a wrapper refuses its arguments or what it is put around.
    """

    def __init__(
        self,
        agent: str,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        factory: WrapperFactory,
        is_strict: bool = True,
    ) -> None:
        self.agent, self.num_clipped = agent, None if is_strict else 0
        self.base_observation_space = observation_space
        self.base_action_space = action_space
        self._mono = MonoAgentEnv(observation_space, action_space)
        self._split_step: SplitStep | None = None
        with agent_failures(agent, "wrap its environment", (ConfigError,)):
            self.env = self._mono if factory is None else factory(self._mono)
            self._set_wrappers(_wrappers_between(self.env, self._mono))
            self.observation_space = self.env.observation_space
            self.action_space = self.env.action_space
        self._door: MonoAgentEnv | CompiledPart = self._mono
        self._owners = (*self._wrappers, self._mono)

    def _set_wrappers(self, wrappers: tuple[Any, ...]) -> None:
        self._wrappers = wrappers
        self._is_plain = all(map(_has_plain_step, wrappers))
        self.is_pure = all(_is_compiled(w) and not w.has_memory for w in wrappers)

    def compile(self, columns: Sequence[str]) -> ViewPlan:
        """Leaves the wrappers that the kernel can do, the innermost ones, to the kernel.

        From then on the chain's base is what these make of the race.

        Args:
            columns: the keys of the base actions, in the order of the controls.

        Returns:
            What the kernel is to do.
        """
        observed: Any = self.base_observation_space
        acted: Any = self.base_action_space
        plan = ViewPlan(observed, acted, columns)
        walked = list(self._wrappers)
        compiled = None
        while walked and _is_compiled(walked[-1]) and walked[-1].compile_into(plan):
            compiled = walked.pop()
        if compiled is not None:
            self.base_observation_space = compiled.observation_space
            self.base_action_space = compiled.action_space
        if compiled is not None and walked:
            walked[-1].env = self._door = CompiledPart(compiled)
            self._owners = (*self._owners, self._door)
        self._set_wrappers(tuple(walked))
        return plan

    @property
    def is_empty(self) -> bool:
        """Whether the chain has no wrappers, or the kernel does the work of all."""
        return not self._wrappers

    def paths_used(self) -> int | None:
        """How many track segments the chain looks at; ``None`` is all."""
        innermost = self._wrappers[-1] if self._wrappers else None
        return getattr(innermost, "state_paths", None) if _is_compiled(innermost) else None

    def reset(
        self,
        observation: Any,
        info: dict[str, Any],
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Calls the wrappers' ``reset`` with the race's first observation and info."""
        self.abandon()
        self._door.start((observation, info))
        try:
            with agent_failures(self.agent, "reset"):
                observation, info = self.env.reset(seed=seed, options=options)
                return observation, dict(info)
        finally:
            self._door.start(None)

    def read_action(self, action: object) -> Any:
        """An action that is in the agent's space, in Gymnasium's form.

        Raises:
            ActionError: it is not.
        """
        return self._checked(self.action_space, action, "action")

    def begin_step(self, action: Any) -> Any:
        """Runs the half before the race's step: the base action for the agent's action."""
        self.abandon()
        with agent_failures(self.agent, "change its action"):
            if self._is_plain:
                return self.act(action)
            self._split_step = SplitStep(self.env.step, action)
            self._door.connect(self._split_step)
            try:
                return self._split_step.begin()
            except BaseException:
                self.abandon()
                raise

    def begin_base_step(self, action: Any) -> Any:
        """Like :meth:`begin_step`, and the base action is checked.

        Raises:
            ActionError: the wrappers made an action that is not in the base space.
        """
        base = self.begin_step(action)
        name = "action after its wrappers" if self._wrappers else "action"
        return self._checked(self.base_action_space, base, name)

    def _checked(self, space: spaces.Space[Any], action: object, name: str) -> Any:
        try:
            return read_action(space, action, self.agent, name)
        except ActionError:
            if self.num_clipped is None:
                raise
            clipped = read_action(space, clip_numbers(space, action), self.agent, name)
            self.num_clipped += 1
            return clipped

    def finish_step(self, result: AgentStep) -> AgentStep:
        """Runs the half after the race's step on the agent's part of the result."""
        with agent_failures(self.agent, "change the result of a step"):
            observation, reward, terminated, truncated, info = (
                self._pass_out(result) if self._is_plain else self._finish_split_step(result)
            )
            return observation, float(reward), bool(terminated), bool(truncated), dict(info)

    def act(self, action: Any) -> Any:
        """The base action that plain wrappers make of an action."""
        for wrapper in self._wrappers:
            if type(wrapper).step in _ACTING:
                action = wrapper.action(action)
        return action

    def observe(self, observation: Any) -> Any:
        """The observation that plain wrappers make of a base observation."""
        for wrapper in reversed(self._wrappers):
            if type(wrapper).step in _OBSERVING:
                observation = wrapper.observation(observation)
        return observation

    def _pass_out(self, result: AgentStep) -> AgentStep:
        observation, reward, terminated, truncated, info = result
        for wrapper in reversed(self._wrappers):
            if type(wrapper).step in _OBSERVING:
                observation = wrapper.observation(observation)
            elif type(wrapper).step is gym.RewardWrapper.step:
                reward = wrapper.reward(reward)
        return observation, reward, terminated, truncated, info

    def _finish_split_step(self, result: AgentStep) -> AgentStep:
        begun, self._split_step = self._split_step, None
        if begun is None:
            raise RuntimeError("a step was finished that was never begun.")
        try:
            return begun.finish(result)
        finally:
            self._door.connect(None)

    def abandon(self) -> None:
        """Forgets a step that was begun and will not be finished."""
        self._door.connect(None)
        if self._split_step is not None:
            self._split_step.abandon()
            self._split_step = None

    def _remembering(self) -> tuple[Any, ...]:
        """What has a memory: nothing, if the wrappers are pure functions."""
        return () if self.is_pure else self._owners

    def memory(self) -> WrapperMemory:
        """What the wrappers remember between steps.

        Raises:
            AgentException: they hold something that cannot be copied.
        """
        self.abandon()
        with agent_failures(self.agent, "have their state copied"):
            return WrapperMemory.of(self._remembering())

    def check_memory(self, memory: WrapperMemory) -> None:
        """Checks that :meth:`recall` can take a memory.

        Raises:
            AgentException: it is one of other wrappers.
        """
        with agent_failures(self.agent, "take over a saved state"):
            memory.check(self._remembering())

    def recall(self, memory: WrapperMemory) -> None:
        """Makes the wrappers remember what :meth:`memory` gave, here or in an equal chain.

        Args:
            memory: one that :meth:`check_memory` takes.

        Raises:
            AgentException: a wrapper's memory cannot be copied.
        """
        self.abandon()
        with agent_failures(self.agent, "take over a saved state"):
            memory.give_to(self._remembering())

    def close(self) -> None:
        """Forgets a begun step and closes the wrappers."""
        self.abandon()
        with agent_failures(self.agent, "close"):
            self.env.close()

    def __getstate__(self) -> dict[str, Any]:
        self.abandon()
        return self.__dict__

    def __del__(self) -> None:
        begun = self.__dict__.get("_split_step")
        if begun is not None:
            begun.abandon()


def _wrappers_between(env: object, mono: MonoAgentEnv) -> tuple[Any, ...]:
    """The wrappers from the outermost to the innermost."""
    if not isinstance(env, gym.Env):
        raise TypeError(f"the factory returned {env!r}; expected the environment, wrapped.")
    wrappers: list[Any] = []
    inner: object = env
    while isinstance(inner, gym.Wrapper):
        wrappers.append(inner)
        inner = inner.env
    if inner is not mono:
        raise TypeError(
            f"the factory returned {env!r}, which does not lead to the environment that it was "
            "given. Wrap that one and return the outermost wrapper."
        )
    return tuple(wrappers)


def _has_plain_step(wrapper: gym.Wrapper[Any, Any, Any, Any]) -> bool:
    return type(wrapper).step in _PLAIN_STEPS and "step" not in vars(wrapper)


def _is_compiled(wrapper: Any) -> bool:
    """Whether a wrapper says how the kernel does its work, and nothing was put over that."""
    return (
        isinstance(wrapper, CompiledWrapper)
        and wrapper.keeps_promise()
        and _has_plain_step(wrapper)  # type: ignore[arg-type]
    )


def _spaces(owners: Sequence[Any]) -> dict[int, Any]:
    values = [value for owner in owners for value in vars(owner).values()]
    return {id(value): value for value in values if isinstance(value, spaces.Space)}


def _names(kinds: list[type]) -> str:
    return ", ".join(kind.__name__ for kind in kinds) or "pure functions"
