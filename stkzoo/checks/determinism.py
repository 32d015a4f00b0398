"""Checks that a seed determines a race, in any environment and process and at any time."""

from __future__ import annotations

import contextlib
import itertools
import os
import random
import signal
from contextlib import closing
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
import numpy as np

from stkzoo.checks.play import (
    CheckFailed,
    Env,
    EnvFactory,
    NotApplicable,
    Trace,
    expect,
    expect_equal,
    fingerprint,
    play,
    short_race,
    trace,
    whole_race,
)
from stkzoo.checks.processes import descendants, run_fresh

_SEED = 13
_FEW_STEPS = 20
_SOME_STEPS = 120


def check_seed_repeats_in_one_env(make_env: EnvFactory) -> None:
    """One environment repeats a whole race with the same seed, also after another seed.

    Raises:
        CheckFailed: the races differ; the message names step, agent and key.
    """
    with closing(whole_race(make_env)()) as env:
        first = trace(play(env, _SEED))
        trace(play(env, _SEED + 1, max_steps=_FEW_STEPS))
        second = trace(play(env, _SEED))
    expect_equal(first, second, "two races of one environment with one seed")


def check_seed_repeats_in_two_envs(make_env: EnvFactory) -> None:
    """Two environments with the same seed play the same whole race.

    Raises:
        CheckFailed: the races differ.
    """
    first, second = (_one_race(whole_race(make_env), _SEED) for _ in range(2))
    expect_equal(first, second, "races of two environments with one seed")


def check_seed_repeats_in_a_fresh_process(make_env: EnvFactory) -> None:
    """A whole race is the same in a new interpreter with another hash seed.

    Raises:
        CheckFailed: the races differ.
    """
    make = whole_race(make_env)
    there, _ = run_fresh(_one_race, make, _SEED)
    expect_equal(_one_race(make, _SEED), there, "races here and in a fresh process")


def check_seed_repeats_after_a_killed_worker(make_env: EnvFactory) -> None:
    """A whole race is the same after the game process was killed, during or after a race.

    Raises:
        CheckFailed: the races differ.
        NotApplicable: the environment starts no process.
    """
    before = descendants()
    with closing(whole_race(make_env)()) as env:
        made = descendants()
        expected = trace(play(env, _SEED))
        workers = descendants() - made or made - before
        if not workers:
            raise NotApplicable("the environment starts no process of its own")
        _kill(workers)
        made = descendants()
        trace(play(env, _SEED + 1, max_steps=_FEW_STEPS))
        _kill(descendants() - made)
        actual = trace(play(env, _SEED))
    expect_equal(expected, actual, "races before and after a killed worker process")


def check_other_seed_differs(make_env: EnvFactory) -> None:
    """Races with three seeds and the same actions are not all equal.

    Raises:
        CheckFailed: all three races are equal.
    """
    with closing(whole_race(make_env)()) as env:
        races = [trace(play(env, _SEED + i, max_steps=_SOME_STEPS)) for i in range(3)]
    expect(
        not races[0] == races[1] == races[2],
        f"seeds {_SEED} to {_SEED + 2} gave the same race bit by bit; expected a seed to matter",
    )


def check_unseeded_resets_continue_the_stream(make_env: EnvFactory) -> None:
    """``reset(seed)``, ``reset()``, ``reset()`` repeats as a sequence, and its races differ.

    Raises:
        CheckFailed: the sequence does not repeat, or all three races are equal.
    """
    with closing(short_race(make_env)()) as env:
        once, again = (_three_races(env) for _ in range(2))
    for number, (first, second) in enumerate(zip(once, again, strict=True)):
        expect_equal(first, second, f"races number {number} of reset(seed), reset(), reset()")
    expect(
        not once[0] == once[1] == once[2],
        "reset() without a seed started the same race again and again; expected it to go on with "
        "the random stream",
    )


def check_global_random_state_is_left_alone(make_env: EnvFactory) -> None:
    """The environment neither draws from nor seeds ``random`` and ``numpy.random``.

    Raises:
        CheckFailed: the state of either generator has changed.
    """
    before = _global_states()
    with closing(short_race(make_env)()) as env:
        _check_global_states(before, "the environment was made")
        for seed in (_SEED, None):
            for step in play(env, seed):
                _check_global_states(before, f"step {step.number} after reset(seed={seed})")
    _check_global_states(before, "close()")


def check_envs_in_turn_do_not_meet(make_env: EnvFactory) -> None:
    """Two environments stepped in turn play the same races as each does alone.

    Raises:
        CheckFailed: a race differs.
    """
    make = whole_race(make_env)
    alone = [_one_race(make, seed) for seed in (_SEED, _SEED + 1)]
    with closing(make()) as left, closing(make()) as right:
        in_turn: tuple[Trace, Trace] = [], []
        for steps in itertools.zip_longest(play(left, _SEED), play(right, _SEED + 1)):
            for record, step in zip(in_turn, steps, strict=True):
                record.extend(trace([step]) if step is not None else [])
    for expected, actual in zip(alone, in_turn, strict=True):
        expect_equal(expected, actual, "races alone and in turn with another environment's")


def check_pickled_copies_play_the_same_race(make_env: EnvFactory) -> None:
    """Copies by cloudpickle, before a reset and in mid-race, play the same whole race.

    Copying does not disturb the original race.

    Raises:
        CheckFailed: the races differ, or the environment cannot be copied.
    """
    make = whole_race(make_env)
    with closing(make()) as env:
        with closing(_copy(env, "before its first reset")) as copy:
            expected = trace(play(copy, _SEED))
        original: Trace = []
        for step in play(env, _SEED):
            original.extend(trace([step]))
            if step.number == _FEW_STEPS:
                with closing(_copy(env, "in mid-race")) as copy:
                    expect_equal(
                        expected,
                        trace(play(copy, _SEED)),
                        "races of copies taken before the first reset and in mid-race",
                    )
    expect_equal(expected, original, "races of a pickled copy and of its original")


def _one_race(make: EnvFactory, seed: int) -> Trace:
    with closing(make()) as env:
        return trace(play(env, seed))


def _three_races(env: Env) -> list[Trace]:
    return [trace(play(env, seed, max_steps=_FEW_STEPS)) for seed in (_SEED, None, None)]


def _copy(env: Env, when: str) -> Any:
    try:
        return cloudpickle.loads(cloudpickle.dumps(env))
    except Exception as error:
        raise CheckFailed(
            f"the environment cannot be copied by cloudpickle {when}: {error!r}; expected a "
            "copy, as vector environments make them"
        ) from error


def _kill(pids: frozenset[int]) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _global_states() -> dict[str, str]:
    return {
        "random": fingerprint(random.getstate()),
        "numpy.random": fingerprint(np.random.get_state()),
    }


def _check_global_states(before: dict[str, str], when: str) -> None:
    for name, state in _global_states().items():
        expect(
            state == before[name],
            f"the global state of {name} has changed by the time of: {when}; expected the "
            "environment to use its own np_random",
        )
