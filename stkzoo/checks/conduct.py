"""Checks of agents' participation, and of wrong calls and actions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.checks.play import (
    PARTS,
    CheckFailed,
    Env,
    EnvFactory,
    NotApplicable,
    RandomPolicy,
    Step,
    expect,
    expect_equal,
    fingerprint,
    play,
    short_race,
    trace,
    whole_race,
)
from stkzoo.checks.processes import run_fresh

_SEED = 14
_FEW_STEPS = 20


def check_keys_are_the_acting_agents(make_env: EnvFactory) -> None:
    """All result dicts have exactly the agents that acted as keys, also in their last step.

    Raises:
        CheckFailed: an agent is missing or unexpected; the message names it, the step and the dict.
    """
    for step in _whole_race(make_env, 4):
        for name, part in step.parts.items():
            missing = [agent for agent in step.acting if agent not in part]
            surplus = [agent for agent in part if agent not in step.acting]
            expect(
                not missing and not surplus,
                f"step {step.number}: {name} lacks {missing} and has {surplus} too many; "
                f"expected exactly the agents that acted: {list(step.acting)}",
            )


def check_agents_leave_when_done(make_env: EnvFactory) -> None:
    """Agents start in the order of ``possible_agents`` and leave ``agents`` for good when they end.

    Raises:
        CheckFailed: an agent leaves at another time, or returns.
    """
    with closing(whole_race(make_env)()) as env:
        for step in play(env, 5):
            if step.number == 0:
                expected = tuple(env.possible_agents)
            else:
                expected = tuple(a for a in step.acting if not step.is_end_of(a))
            expect(
                step.agents == expected,
                f"step {step.number}: agents are {list(step.agents)}, expected {list(expected)}: "
                "all at first, then those that were neither terminated nor truncated",
            )


def check_types_of_rewards_and_ends(make_env: EnvFactory) -> None:
    """Rewards are finite Python ``float``; ends are Python ``bool`` and never both true.

    Raises:
        CheckFailed: a value has another type or is not finite, or both ends are true.
    """
    for step in _whole_race(make_env, 6):
        for name, kind in (("rewards", float), ("terminations", bool), ("truncations", bool)):
            for agent, value in getattr(step, name).items():
                expect(
                    type(value) is kind and math.isfinite(value),
                    f"step {step.number}: {name}[{agent!r}] is {value!r} of type "
                    f"{type(value).__name__}, expected a finite {kind.__name__}",
                )
        for agent in step.acting:
            expect(
                not (step.terminations.get(agent) and step.truncations.get(agent)),
                f"step {step.number}: agent {agent!r} is terminated and truncated at once; "
                "expected one of the two",
            )


def check_finished_agents_leave_the_rest_racing(make_env: EnvFactory) -> None:
    """After the first agents' end, the race continues for the others only.

    Raises:
        CheckFailed: the race stops, or a departed agent still gets results.
        NotApplicable: all agents ended in the same step.
    """
    departed: set[Any] = set()
    before: Step | None = None
    for step in _whole_race(make_env, 7):
        for name, part in step.parts.items():
            served = departed.intersection(part)
            expect(
                not served,
                f"step {step.number}: {name} still serves {sorted(map(repr, served))}, who left "
                "before; expected nothing for them",
            )
        if departed and before is not None:
            _check_moved(before, step)
        departed |= {agent for agent in step.acting if step.is_end_of(agent)}
        before = step
    if before is None or not departed - set(before.acting):
        raise NotApplicable("all agents ended in the same step")


def check_step_after_the_end_is_empty(make_env: EnvFactory) -> None:
    """``step`` after the end returns five empty dicts, with or without actions.

    Raises:
        CheckFailed: it returns other values, or raises.
    """
    with closing(whole_race(make_env)()) as env:
        last = [step.number for step in play(env, 8)][-1]
        actions = {agent: env.action_space(agent).sample() for agent in env.possible_agents}
        for passed in ({}, actions, {}):
            what = "step(actions)" if passed else "step({})"
            try:
                result = env.step(dict(passed))
            except Exception as error:
                raise CheckFailed(
                    f"{what} after the end (step {last}) raised {error!r}, expected five empty "
                    "dicts: several libraries make that call"
                ) from error
            expect(
                list(result) == [{}] * len(PARTS),
                f"{what} after the end (step {last}) returned {result!r}, expected five empty "
                "dicts",
            )


def check_actions_of_departed_agents_are_ignored(make_env: EnvFactory) -> None:
    """Actions of departed agents do not change the race.

    Raises:
        CheckFailed: the race differs, or an action was rejected.
        NotApplicable: all agents ended in the same step.
    """
    with closing(whole_race(make_env)()) as env:
        lengths = {}
        recorded = []
        for step in play(env, 9):
            lengths.update(dict.fromkeys(step.acting, step.number))
            recorded.append(step)
        if len(set(lengths.values())) < 2:
            raise NotApplicable("all agents ended in the same step")
        loud = trace(play(env, 9, policy=RandomPolicy(env, with_departed=True)))
    expect_equal(trace(recorded), loud, "races without and with actions of departed agents")


def _whole_race(make_env: EnvFactory, seed: int) -> Iterator[Step]:
    with closing(whole_race(make_env)()) as env:
        yield from play(env, seed)


def _check_moved(before: Step, step: Step) -> None:
    for agent in step.acting:
        last = fingerprint([before.observations.get(agent), before.infos.get(agent)])
        expect(
            fingerprint([step.observations.get(agent), step.infos.get(agent)]) != last,
            f"step {step.number}: nothing has moved for agent {agent!r} since another agent left; "
            "expected the race to go on",
        )


def check_nothing_is_written_to_the_terminal(make_env: EnvFactory) -> None:
    """A new process that makes, plays and closes an environment prints nothing.

    Raises:
        CheckFailed: the process wrote to a standard stream.
    """
    _, output = run_fresh(_play_a_little, short_race(make_env))
    expect(not output, f"a short race wrote to the terminal: {output!r}; expected silence")


def check_close_can_be_repeated_and_undone(make_env: EnvFactory) -> None:
    """``close`` works twice and before any reset, and ``reset`` works after it.

    Raises:
        CheckFailed: the race after ``close`` differs.
    """
    make = short_race(make_env)
    make().close()
    with closing(make()) as env:
        expected = trace(play(env, _SEED))
        env.close()
        env.close()
        actual = trace(play(env, _SEED))
        trace(play(env, _SEED, max_steps=_FEW_STEPS))
        env.close()
    expect_equal(expected, actual, "races before and after close()")


def check_render_without_a_mode_warns(make_env: EnvFactory) -> None:
    """``render`` without a render mode returns ``None`` and warns.

    Raises:
        CheckFailed: it returns a value, or does not warn.
        NotApplicable: the factory chooses a render mode itself.
    """
    with closing(short_race(make_env)()) as env:
        if getattr(env, "render_mode", None) is not None:
            raise NotApplicable(f"the environment has the render mode {env.render_mode!r}")
        env.reset(seed=_SEED)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            frame = env.render()
        expect(frame is None, f"render() without a mode returned {frame!r}, expected None")
        expect(caught, "render() without a mode was silent, expected a warning")


def check_bad_actions_are_refused(make_env: EnvFactory) -> None:
    """Invalid actions raise an error that names the agent, and the race does not advance.

    Raises:
        CheckFailed: an action was accepted, the error names no agent, or the race advanced.
    """
    with closing(short_race(make_env)()) as env:
        expected = trace(play(env, _SEED, max_steps=_FEW_STEPS))
        policy = _Misbehaving(env)
        actual = trace(play(env, _SEED, max_steps=_FEW_STEPS, policy=policy))
    expect_equal(expected, actual, "races without and with refused actions in between")


class _Misbehaving(RandomPolicy):
    """A policy that tries all invalid actions before it returns the next valid ones."""

    def __init__(self, env: Env) -> None:
        super().__init__(env)
        self._env = env

    def __call__(self, step: Step) -> dict[Any, Any]:
        actions = super().__call__(step)
        agent = step.agents[-1]
        others = {other: actions[other] for other in step.agents[:-1]}
        _expect_refusal(self._env, others, agent, f"step {step.number}: no action")
        for what, bad in _bad_actions(self._env.action_space(agent), actions[agent], "action"):
            _expect_refusal(self._env, {**others, agent: bad}, agent, f"step {step.number}: {what}")
        return actions


def _expect_refusal(env: Env, actions: dict[Any, Any], agent: Any, what: str) -> None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            env.step(actions)
    except Exception as error:
        if str(agent) not in str(error):
            raise CheckFailed(
                f"{what} of agent {agent!r} was refused with {error!r}, expected a text that "
                "names the agent"
            ) from error
    else:
        raise CheckFailed(f"{what} of agent {agent!r} was accepted, expected an error")


def _bad_actions(space: spaces.Space[Any], good: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yields descriptions and actions that are not in a space."""
    yield f"{path}=None", None
    yield f"{path}='left'", "left"
    if isinstance(space, spaces.Dict):
        for key, part in space.spaces.items():
            yield f"{path} without {key!r}", {k: v for k, v in good.items() if k != key}
            for what, bad in _bad_actions(part, good[key], f"{path}[{key!r}]"):
                yield what, {**good, key: bad}
    elif isinstance(space, spaces.Box):
        yield from _bad_arrays(space, path)
    elif isinstance(space, spaces.Discrete):
        for number in (space.start - 1, space.start + space.n, space.start + 0.5, float("nan")):
            yield f"{path}={number}", number
    elif isinstance(space, spaces.MultiDiscrete):
        yield f"{path} above its bounds", np.asarray(space.start + space.nvec, space.dtype)
        yield f"{path} below its bounds", np.asarray(space.start - 1, space.dtype)
        yield f"{path} of another shape", np.zeros((*space.nvec.shape, 3), space.dtype)


def _bad_arrays(space: spaces.Box, path: str) -> Iterator[tuple[str, Any]]:
    if space.dtype.kind == "f":
        for number in (np.nan, np.inf, -np.inf):
            yield f"{path}={number}", np.full(space.shape, number, space.dtype)
    if space.is_bounded("above"):
        yield f"{path} above its bounds", np.asarray(space.high + 1, space.dtype)
    if space.is_bounded("below") and space.dtype.kind != "u":
        yield f"{path} below its bounds", np.asarray(space.low - 1, space.dtype)
    yield f"{path} of another shape", np.broadcast_to(space.low[..., None], (*space.shape, 3))


def _play_a_little(make: EnvFactory) -> None:
    with closing(make()) as env:
        for seed in (_SEED, None):
            trace(play(env, seed, max_steps=_FEW_STEPS))
