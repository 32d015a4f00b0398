"""Checks of calls and actions that users get wrong, and of what reaches the terminal."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.checks.play import (
    CheckFailed,
    Env,
    EnvFactory,
    NotApplicable,
    RandomPolicy,
    Step,
    expect,
    expect_equal,
    play,
    short_race,
    trace,
)
from stkzoo.checks.processes import run_fresh

_SEED = 14
_FEW_STEPS = 20


def check_nothing_is_written_to_the_terminal(make_env: EnvFactory) -> None:
    """A fresh process that makes, plays and closes an environment writes nothing.

    Raises:
        CheckFailed: something came out of its standard streams.
    """
    _, output = run_fresh(_play_a_little, short_race(make_env))
    expect(not output, f"a short race wrote to the terminal: {output!r}; expected silence")


def check_close_can_be_repeated_and_undone(make_env: EnvFactory) -> None:
    """``close`` may be called twice or before any reset; ``reset`` still works after it.

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
    """``render`` of an environment without a render mode returns ``None`` and warns.

    Raises:
        CheckFailed: it returns something, or does not warn.
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
    """Actions outside their space raise an error that names the agent; the race does not advance.

    Raises:
        CheckFailed: one was accepted, the error names no agent, or the race has moved.
    """
    with closing(short_race(make_env)()) as env:
        expected = trace(play(env, _SEED, max_steps=_FEW_STEPS))
        policy = _Misbehaving(env)
        actual = trace(play(env, _SEED, max_steps=_FEW_STEPS, policy=policy))
    expect_equal(expected, actual, "races without and with refused actions in between")


class _Misbehaving(RandomPolicy):
    """Tries all bad actions on the environment before it chooses the next good ones."""

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
    """Actions that are not in a space, with descriptions."""
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
