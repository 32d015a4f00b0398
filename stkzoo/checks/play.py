"""Plays, records and compares the races of the checks.

A check takes a factory of environments. It plays races with a fixed seed and inspects every step,
or compares fingerprints of whole races bit by bit.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import inspect
import pkgutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import msgpack
import numpy as np
from pettingzoo import ParallelEnv

from stkzoo.config import AgentSpec
from stkzoo.errors import ConfigError, StkzooError


class CheckFailed(StkzooError):
    """The environment breaks a rule; the message says where, and what was expected."""


class NotApplicable(StkzooError):
    """The check does not apply to this environment; the message says why."""


def expect(is_met: object, failure: str) -> None:
    """Raises :class:`CheckFailed` with a message unless a condition is true."""
    if not is_met:
        raise CheckFailed(failure)


#: Returns a new environment at every call.
EnvFactory: TypeAlias = Callable[..., ParallelEnv[Any, Any, Any]]

#: A track that the game's AI finishes in about 300 steps.
_TRACK = "olivermath"
_SHORT_RACE_STEPS = 60
_WHOLE_RACE_STEPS = 380


def load_factory(target: str) -> EnvFactory:
    """Loads the factory named ``"module:callable"``.

    Raises:
        ConfigError: the module or the callable does not exist.
    """
    if not all(target.partition(":")):
        raise ConfigError(
            f"the environment is {target!r}, expected module:callable, such as "
            "stkzoo.race_v0:parallel_env"
        )
    try:
        factory = pkgutil.resolve_name(target)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(
            f"the environment {target!r} cannot be loaded: {error}; run the command from a "
            "folder, or with a PYTHONPATH, from which the module can be imported"
        ) from error
    if not callable(factory):
        raise ConfigError(
            f"{target!r} is {factory!r}, expected a function that makes a ParallelEnv"
        )
    made: EnvFactory = factory
    return made


def takes(make_env: EnvFactory, name: str) -> bool:
    """Whether the factory's signature has a keyword that is not bound yet."""
    bound = make_env.keywords if isinstance(make_env, functools.partial) else {}
    return name in _parameters(make_env) and name not in bound


def bind(make_env: EnvFactory, name: str, value: Any) -> EnvFactory:
    """Returns the factory with one keyword bound.

    Raises:
        ConfigError: the factory does not accept the keyword.
    """
    parameters = _parameters(make_env)
    takes_any = any(p.kind == inspect.Parameter.VAR_KEYWORD for p in parameters.values())
    if name not in parameters and not takes_any:
        raise ConfigError(
            f"the environment's factory takes no {name!r}; it takes: {', '.join(parameters)}"
        )
    return functools.partial(make_env, **{name: value})


def short_race(make_env: EnvFactory) -> EnvFactory:
    """Binds arguments for races of 60 steps with three agents, if the factory accepts them."""
    return _fitted(make_env, track=_TRACK, num_kart=3, max_cycles=_SHORT_RACE_STEPS)


def whole_race(make_env: EnvFactory) -> EnvFactory:
    """Binds arguments for races whose agents end at different times, if the factory accepts them.

    With the keywords of :func:`stkzoo.race_v0.parallel_env`, one agent acts at random, the game
    drives two agents to the finish, and a fourth kart is a bot.
    """
    options: dict[str, Any] = {"track": _TRACK, "max_cycles": _WHOLE_RACE_STEPS}
    if takes(make_env, "agents") and takes(make_env, "num_kart"):
        options["num_kart"] = 4
        options["agents"] = [AgentSpec(), AgentSpec(use_ai=True), AgentSpec(use_ai=True)]
    return _fitted(make_env, **options)


def _parameters(make_env: EnvFactory) -> dict[str, inspect.Parameter]:
    try:
        return dict(inspect.signature(make_env).parameters)
    except (TypeError, ValueError):  # some callables have no signature
        return {}


def _fitted(make_env: EnvFactory, **options: Any) -> EnvFactory:
    known = {name: value for name, value in options.items() if takes(make_env, name)}
    return functools.partial(make_env, **known)


Env: TypeAlias = ParallelEnv[Any, Any, Any]

#: The values that ``step`` returns, in order.
PARTS = ("observations", "rewards", "terminations", "truncations", "infos")

#: Step limit; a longer episode counts as endless.
_MAX_STEPS = 20_000


@dataclass(frozen=True, slots=True)
class Step:
    """One ``reset`` or ``step`` of an environment.

    Attributes:
        number: 0 for the reset, then 1, 2, ...
        acting: agents before the step; for a reset, the agents after it.
        actions: actions by agent.
        observations: observations by agent.
        rewards: rewards by agent; empty for a reset, as are the ends.
        terminations: terminations by agent.
        truncations: truncations by agent.
        infos: infos by agent.
        agents: agents after the step.
    """

    number: int
    acting: tuple[Any, ...]
    actions: Mapping[Any, Any]
    observations: dict[Any, Any]
    rewards: dict[Any, Any] = field(default_factory=dict)
    terminations: dict[Any, Any] = field(default_factory=dict)
    truncations: dict[Any, Any] = field(default_factory=dict)
    infos: dict[Any, Any] = field(default_factory=dict)
    agents: tuple[Any, ...] = ()

    @property
    def parts(self) -> dict[str, dict[Any, Any]]:
        """Returns the results by the names in :data:`PARTS`."""
        names = ("observations", "infos") if self.number == 0 else PARTS
        return {name: getattr(self, name) for name in names}

    def is_end_of(self, agent: Any) -> bool:
        """Whether the agent was terminated or truncated in this step."""
        return bool(self.terminations.get(agent) or self.truncations.get(agent))


#: Returns the actions for the step after a given one.
Policy: TypeAlias = Callable[[Step], Mapping[Any, Any]]


class RandomPolicy:
    """Samples actions from copies of the action spaces, so that other samplers are unaffected.

    Args:
        env: the environment.
        seed: seed of the samples.
        with_departed: whether to return actions for agents that have left, too.
    """

    def __init__(self, env: Env, seed: int = 0, with_departed: bool = False) -> None:
        self._with_departed = with_departed
        self._spaces = {}
        for number, agent in enumerate(env.possible_agents):
            self._spaces[agent] = space = copy.deepcopy(env.action_space(agent))
            space.seed(1000 * seed + number)

    def __call__(self, step: Step) -> dict[Any, Any]:
        """Returns actions by agent."""
        agents = self._spaces if self._with_departed else step.agents
        return {agent: self._spaces[agent].sample() for agent in agents}


def play(
    env: Env,
    seed: int | None,
    *,
    max_steps: int | None = None,
    policy: Policy | None = None,
    options: dict[str, Any] | None = None,
) -> Iterator[Step]:
    """Resets an environment and steps it to the end.

    Args:
        env: the environment.
        seed: seed for ``reset``.
        max_steps: number of steps after which to stop.
        policy: chooses actions; ``None`` samples them with a fixed seed.
        options: options for ``reset``.

    Yields:
        The reset and every step.

    Raises:
        CheckFailed: a result has the wrong type, or the episode does not end.
    """
    policy = policy or RandomPolicy(env)
    observations, infos = _dicts("reset", env.reset(seed=seed, options=options), 2)
    agents = tuple(env.agents)
    step = Step(0, agents, {}, observations, infos=infos, agents=agents)
    yield step
    while step.agents and step.number != max_steps:
        expect(
            step.number < _MAX_STEPS,
            f"the episode has no end: {', '.join(map(repr, step.agents))} still act after "
            f"{_MAX_STEPS} steps; give the environment a limit (max_cycles)",
        )
        actions = policy(step)
        results = _dicts("step", env.step(dict(actions)), len(PARTS))
        parts = dict(zip(PARTS, results, strict=True))
        step = Step(step.number + 1, step.agents, actions, agents=tuple(env.agents), **parts)
        yield step


def _dicts(method: str, result: Any, count: int) -> tuple[dict[Any, Any], ...]:
    if not isinstance(result, tuple) or len(result) != count:
        what = f"{len(result)} values" if isinstance(result, tuple) else type(result).__name__
        raise CheckFailed(f"{method}() returned {what}, expected a tuple of {count} dicts")
    for number, part in enumerate(result):
        expect(
            isinstance(part, dict),
            f"{method}() returned a {type(part).__name__} in place {number}, expected a dict by "
            "agent",
        )
    return result


#: For each step, a fingerprint of every result, by its path.
Trace: TypeAlias = list[dict[str, str]]


def trace(steps: Iterable[Step]) -> Trace:
    """Returns the fingerprints of a race's steps."""
    return [dict(_fingerprints_of_step(step)) for step in steps]


def fingerprint(value: Any) -> str:
    """Returns a hash of a value's types and bits as 16 hex digits, including nested containers."""
    packed = msgpack.packb(
        value, default=_packable, strict_types=True, unicode_errors="surrogatepass"
    )
    return hashlib.blake2b(packed, digest_size=8).hexdigest()


def first_difference(expected: Trace, actual: Trace) -> str | None:
    """Describes where two races first differ; ``None`` if they are equal."""
    for number, (left, right) in enumerate(zip(expected, actual, strict=False)):
        for path in left | right:
            if left.get(path) != right.get(path):
                return f"first at step {number} in {path}"
    if len(expected) != len(actual):
        return f"one ends at step {len(expected) - 1}, the other at step {len(actual) - 1}"
    return None


def expect_equal(expected: Trace, actual: Trace, what: str) -> None:
    """Compares two races that should be equal.

    Args:
        expected: one race.
        actual: the other race.
        what: description of both races, as the subject of a sentence.

    Raises:
        CheckFailed: the races differ.
    """
    difference = first_difference(expected, actual)
    expect(difference is None, f"{what} differ, {difference}; expected the same bits")


def _fingerprints_of_step(step: Step) -> Iterator[tuple[str, str]]:
    yield "agents", fingerprint(step.agents)
    for name, part in step.parts.items():
        yield from _fingerprints(name, part)


def _fingerprints(path: str, value: Any) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        yield f"the keys of {path}", fingerprint(sorted(map(repr, value)))
        for key, entry in value.items():
            yield from _fingerprints(f"{path}[{key!r}]", entry)
    else:
        yield path, fingerprint(value)


def are_alike(values: Sequence[Any], dtype: np.dtype[Any] | None, shape: Any) -> bool:
    """Whether all values are plain arrays with a dtype and a shape."""
    return all(
        type(value) is np.ndarray and value.dtype == dtype and value.shape == shape
        for value in values
    )


def _packable(value: Any) -> Any:
    """Converts a value that msgpack does not support to its type and content."""
    kind = type(value).__name__
    if isinstance(value, (np.ndarray, np.generic)):
        return [kind, value.dtype.str, list(value.shape), value.tobytes()]
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, Sequence) and not isinstance(value, (str, bytes)):
        first = value[0] if value else None
        if isinstance(first, np.ndarray) and are_alike(value, first.dtype, first.shape):
            return [kind, len(value), np.array(value)]  # faster than one by one
        return [kind, list(value)]
    return [kind, repr(value)]


Check: TypeAlias = Callable[[EnvFactory], None]


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of one check.

    Attributes:
        status: ``"passed"``, ``"failed"`` or ``"not applicable"``.
        why: what is wrong, or why the check does not apply; empty if passed.
        seconds: duration [s].
    """

    status: str
    why: str
    seconds: float


def run_check(check: Check, make_env: EnvFactory) -> CheckResult:
    """Runs a check; any exception counts as a failure.

    Args:
        check: function that takes the factory.
        make_env: makes the environment.
    """
    start = time.perf_counter()
    status, why = "failed", ""
    try:
        check(make_env)
        status = "passed"
    except NotApplicable as reason:
        status, why = "not applicable", str(reason)
    except CheckFailed as failure:
        why = str(failure)
    except Exception as error:  # noqa: BLE001 - a broken environment may raise anything
        why = f"{type(error).__name__}: {error}"
    return CheckResult(status, why, time.perf_counter() - start)
