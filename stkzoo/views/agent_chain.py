"""One agent's chain of wrappers, split into the parts before and after the race's step."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium as gym
from gymnasium import spaces

from stkzoo._checks import shortened
from stkzoo.errors import ActionError, AgentError, AgentException, ConfigError
from stkzoo.views.actions import fit_action, read_action
from stkzoo.views.bases import ActionObservationWrapper, CompiledWrapper
from stkzoo.views.plan import ViewPlan
from stkzoo.views.split_step import AgentStep, MonoAgentEnv, SplitStep

if TYPE_CHECKING:
    from stkzoo.wrappers.camera import Camera

_FITTED = "It is clipped, and unknown keys are ignored; only the first action is logged."
logger = logging.getLogger(__name__)

#: Wraps one agent's environment; ``None`` adds no wrapper.
WrapperFactory: TypeAlias = Callable[[gym.Env[Any, Any]], gym.Env[Any, Any]] | None

# Implementations of step that only call `action`, `observation` or `reward`.
_ACTING = (gym.ActionWrapper.step, ActionObservationWrapper.step)
_OBSERVING = (gym.ObservationWrapper.step, ActionObservationWrapper.step)
#: Types of the parts of a wrapper's results; an observation can have any.
_TYPES: dict[str, Any] = {"reward": float, "terminated": bool, "truncated": bool, "info": dict}
_PLAIN_STEPS = (*_ACTING, *_OBSERVING, gym.RewardWrapper.step, gym.Wrapper.step)


@contextmanager
def agent_failures(
    agent: str, doing: str, refusals: tuple[type[Exception], ...] = ()
) -> Iterator[None]:
    """Converts exceptions of an agent's wrappers, except ``refusals``, to ``AgentException``.

    Args:
        agent: the agent's id.
        doing: what the wrappers were doing, for the message.
        refusals: types of exceptions to pass on unchanged.
    """
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
    """A copy of the attributes of several objects at one moment.

    Attributes:
        owners: the objects.
        attributes: their attributes, in the same order. References to an owner stay references to
            that owner, spaces are shared, and all other values are copies.
    """

    owners: tuple[Any, ...]
    attributes: list[dict[str, Any]]

    @classmethod
    def of(cls, owners: Sequence[Any]) -> WrapperMemory:
        """Copies the current attributes of some objects.

        Raises:
            Exception: :func:`copy.deepcopy` cannot copy an attribute.
        """
        memo = {id(owner): owner for owner in owners}
        return cls(tuple(owners), copy.deepcopy([vars(o) for o in owners], memo | _spaces(owners)))

    def give_to(self, others: Sequence[Any]) -> None:
        """Writes the attributes to other objects, or back to the same ones; they keep their spaces.

        Args:
            others: objects of the same classes in the same order.
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
    """The wrappers around one agent, applied to single observations and actions.

    Attributes:
        agent: the agent's id.
        env: the outermost wrapper.
        observation_space: observations after all wrappers.
        action_space: actions before all wrappers.
        base_observation_space: observations before all wrappers.
        base_action_space: actions after all wrappers.
        is_strict: whether finite numbers outside their space and unknown keys are errors, rather
            than clipped and ignored. ``stkzoo.compat`` changes it for all environments.
        num_clipped: number of actions with such numbers or keys, if they are no errors.
        is_empty: whether no wrapper runs here: there is none, or the kernel implements all.
        is_pure: whether all wrappers that run here are pure functions from this package.

    Args:
        agent: the agent's id.
        observation_space: observations without wrappers.
        action_space: actions without wrappers.
        factory: wraps the agent's environment.
        camera: the agent's camera, if the race can render.
        is_strict: see above; by default, that of the class. The first such action of a race is then
            logged.

    Raises:
        AgentException: the factory failed, or did not return a wrapper of its argument.
        ConfigError: a wrapper rejects its arguments or the wrapped environment.
    """

    is_strict = True

    def __init__(
        self,
        agent: str,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        factory: WrapperFactory,
        camera: Camera | None = None,
        is_strict: bool | None = None,
    ) -> None:
        self.agent, self.num_clipped = agent, 0
        self._logs_clipping = is_strict is None
        if is_strict is not None:
            self.is_strict = is_strict
        self.base_observation_space = observation_space
        self.base_action_space = action_space
        self._mono = MonoAgentEnv(observation_space, action_space, camera)
        with agent_failures(agent, "wrap its environment", (ConfigError,)):
            self.env = self._mono if factory is None else factory(self._mono)
            self._set_wrappers(_wrappers_between(self.env, self._mono))
            self.observation_space = self.env.observation_space
            self.action_space = self.env.action_space
        self._owners = (*self._wrappers, self._mono)

    def _set_wrappers(self, wrappers: tuple[Any, ...]) -> None:
        self._wrappers, self.is_empty = wrappers, not wrappers
        self._is_plain = all(map(_has_plain_step, wrappers))
        self.is_pure = all(_is_compiled(w) and not w.has_memory for w in wrappers)

    def compile(self) -> ViewPlan:
        """Moves the innermost wrappers that the kernel implements to the kernel.

        Afterwards, the chain's base spaces are those of the innermost wrapper that remains.

        Returns:
            The plan for the kernel.
        """
        observed: Any = self.base_observation_space
        plan = ViewPlan(observed)
        walked = list(self._wrappers)
        compiled = None
        while walked and _is_compiled(walked[-1]) and walked[-1].compile_into(plan):
            compiled = walked.pop()
        if compiled is not None:
            self.base_observation_space = compiled.observation_space
            self.base_action_space = compiled.action_space
        if compiled is not None and walked:
            # Outer wrappers still have access to it; only its `reset` and `step` are bypassed.
            compiled.reset, compiled.step = self._mono.reset, self._mono.step
        self._set_wrappers(tuple(walked))
        return plan

    def paths_used(self) -> int | None:
        """Returns the number of track segments that the chain uses; ``None`` for all."""
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
        """Calls the wrappers' ``reset`` with the race's first observation and info.

        Raises:
            AgentException: a wrapper failed.
        """
        self.abandon()
        self._mono.first = observation, info
        try:
            with agent_failures(self.agent, "reset"):
                result = self.env.reset(seed=seed, options=options)
                observation, info = _parts_of(result, "observation", "info")
                return observation, info
        finally:
            self._mono.first = None

    def read_action(self, action: object) -> Any:
        """Checks an action and returns it in Gymnasium's form.

        Raises:
            ActionError: the action is not in the agent's space.
        """
        return self._checked(self.action_space, action, "action")

    def begin_step(self, action: Any) -> Any:
        """Runs the part before the race's step; returns the base action for the agent's action.

        Raises:
            ActionError: the wrappers returned an action outside the base space.
        """
        self.abandon()
        with agent_failures(self.agent, "change its action"):
            base = self._pass_in(action) if self._is_plain else self._begin_split_step(action)
        if self.is_pure:
            return base  # as valid as the action
        return self._checked(self.base_action_space, base, "action after its wrappers")

    def _pass_in(self, action: Any) -> Any:
        for wrapper in self._wrappers:
            if type(wrapper).step in _ACTING:
                action = wrapper.action(action)
        return action

    def _begin_split_step(self, action: Any) -> Any:
        begun = self._mono.handler = SplitStep(self.env.step, action)
        try:
            return begun.begin()
        except BaseException:
            self.abandon()
            raise

    def _checked(self, space: spaces.Space[Any], action: object, name: str) -> Any:
        try:
            return read_action(space, action, self.agent, name)
        except ActionError as error:
            if self.is_strict:
                raise
            fitting = read_action(space, fit_action(space, action), self.agent, name)
            self.num_clipped += 1
            if self.num_clipped == 1 and self._logs_clipping:
                logger.warning("%s %s", error, _FITTED)
            return fitting

    def finish_step(self, result: AgentStep) -> AgentStep:
        """Runs the part after the race's step; returns the wrapped result."""
        with agent_failures(self.agent, "change the result of a step"):
            wrapped = self._pass_out(result) if self._is_plain else self._finish_split_step(result)
            names = "observation", "reward", "terminated", "truncated", "info"
            observation, reward, terminated, truncated, info = _parts_of(wrapped, *names)
            return observation, reward, terminated, truncated, info

    def _pass_out(self, result: AgentStep) -> AgentStep:
        observation, reward, terminated, truncated, info = result
        for wrapper in reversed(self._wrappers):
            if type(wrapper).step in _OBSERVING:
                observation = wrapper.observation(observation)
            elif type(wrapper).step is gym.RewardWrapper.step:
                reward = wrapper.reward(reward)
        return observation, reward, terminated, truncated, info

    def _finish_split_step(self, result: AgentStep) -> AgentStep:
        begun = self._mono.handler
        if begun is None:
            raise RuntimeError("a step was finished that was never begun.")
        try:
            return begun.finish(result)
        finally:
            self._mono.handler = None

    def abandon(self) -> None:
        """Discards a step that has begun and will not be finished."""
        begun, self._mono.handler = self._mono.handler, None
        if begun is not None:
            begun.abandon()

    def remembering(self) -> tuple[Any, ...]:
        """Returns the objects with a memory: none if all wrappers are pure functions."""
        return () if self.is_pure else self._owners

    def memory(self) -> WrapperMemory:
        """Returns a copy of the wrappers' state.

        Raises:
            AgentException: a wrapper holds an object that cannot be copied.
        """
        self.abandon()
        with agent_failures(self.agent, "have their state copied"):
            return WrapperMemory.of(self.remembering())

    def recall(self, memory: WrapperMemory) -> None:
        """Restores the wrappers' state from :meth:`memory` of this or an equal chain.

        Args:
            memory: a memory of wrappers of the same classes.

        Raises:
            AgentException: a wrapper's memory cannot be copied.
        """
        self.abandon()
        with agent_failures(self.agent, "take over a saved state"):
            memory.give_to(self.remembering())

    def close(self) -> None:
        """Discards a step that has begun and closes the wrappers."""
        self.abandon()
        with agent_failures(self.agent, "close"):
            self.env.close()

    def __del__(self) -> None:
        if "_mono" in vars(self):
            self.abandon()


def _wrappers_between(env: object, mono: MonoAgentEnv) -> tuple[Any, ...]:
    """Returns the wrappers from the outermost to the innermost."""
    if not isinstance(env, gym.Env):
        raise TypeError(f"the view returned {shortened(env)}; expected its environment, wrapped")
    wrappers: list[Any] = []
    inner: object = env
    while isinstance(inner, gym.Wrapper):
        wrappers.append(inner)
        inner = inner.env
    if inner is not mono:
        raise TypeError(
            f"the view returned {shortened(env, 40)}, which does not wrap its environment; wrap "
            "the one that it gets"
        )
    return tuple(wrappers)


def _parts_of(result: object, *names: str) -> list[Any]:
    """Returns the parts of what a wrapper's ``reset`` or ``step`` returned, in plain types.

    Raises:
        TypeError: they are missing or invalid.
    """
    if not isinstance(result, (tuple, list)) or len(result) != len(names):
        raise TypeError(f"they returned {shortened(result, 40)}, expected ({', '.join(names)})")
    parts = []
    for name, value in zip(names, result, strict=True):
        try:
            part = _TYPES[name](value) if name in _TYPES else value
        except (TypeError, ValueError):
            part = None
        if part is None or (name == "reward" and not math.isfinite(part)):
            raise TypeError(f"they returned {shortened(value)} as {name}")
        parts.append(part)
    return parts


def _has_plain_step(wrapper: gym.Wrapper[Any, Any, Any, Any]) -> bool:
    return type(wrapper).step in _PLAIN_STEPS and "step" not in vars(wrapper)


def _is_compiled(wrapper: Any) -> bool:
    """Whether the kernel can replace a wrapper whose class guarantees a plain behavior."""
    return (
        isinstance(wrapper, CompiledWrapper)
        and wrapper.keeps_promise()
        and _has_plain_step(wrapper)  # type: ignore[arg-type]
    )


def _spaces(owners: Sequence[Any]) -> dict[int, Any]:
    values = [value for owner in owners for value in vars(owner).values()]
    return {id(value): value for value in values if isinstance(value, spaces.Space)}
