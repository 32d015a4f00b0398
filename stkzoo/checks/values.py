"""Checks of spaces, of values in these spaces, and of shared memory."""

from __future__ import annotations

import copy
import re
import reprlib
from collections.abc import Iterator, Mapping
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
    are_alike,
    expect,
    expect_equal,
    fingerprint,
    play,
    short_race,
    trace,
    whole_race,
)


def expect_in(space: spaces.Space[Any], value: Any, path: str) -> None:
    """Checks that a value is in a space.

    It is stricter than ``space.contains``: arrays must have the dtype of the space.

    Args:
        space: the space.
        value: the value.
        path: name of the value in the message.

    Raises:
        CheckFailed: the value is not in the space.
    """
    if isinstance(space, spaces.Dict):
        expect(isinstance(value, Mapping), f"{path} is a {type(value).__name__}, expected a dict")
        missing = [key for key in space.spaces if key not in value]
        unknown = [key for key in value if key not in space.spaces]
        expect(
            not missing and not unknown,
            f"{path} lacks the keys {missing} and has the unknown keys {unknown}",
        )
        for key, part in space.spaces.items():
            expect_in(part, value[key], f"{path}[{key!r}]")
    elif isinstance(space, spaces.Sequence) and isinstance(value, tuple):
        if not _are_in_box(space.feature_space, value):
            for number, entry in enumerate(value):
                expect_in(space.feature_space, entry, f"{path}[{number}]")
    elif isinstance(value, np.ndarray) and space.dtype is not None and value.dtype != space.dtype:
        raise CheckFailed(f"{path} has dtype {value.dtype}, expected {space.dtype}")
    elif not space.contains(value):
        raise CheckFailed(f"{path} is {reprlib.repr(value)}, expected a value of {space}")


def _are_in_box(space: spaces.Space[Any], entries: tuple[Any, ...]) -> bool:
    """Whether a space is a box that contains all entries, compared at once."""
    if type(space) is not spaces.Box or not are_alike(entries, space.dtype, space.shape):
        return False
    rows = np.array(entries)
    return bool((rows >= space.low).all() and (rows <= space.high).all())


def arrays_in(value: Any, path: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Yields all arrays in nested dicts, tuples and lists, with their paths."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from arrays_in(entry, f"{path}[{key!r}]")
    elif isinstance(value, (tuple, list)):
        for number, entry in enumerate(value):
            yield from arrays_in(entry, f"{path}[{number}]")


_NUM_STEPS = 30
_KINDS = ("observation_space", "action_space")


def check_spaces_are_constant(make_env: EnvFactory) -> None:
    """Agents' spaces stay the same objects across resets, and are equal within a group.

    Learners group agents whose names differ only in the number after the last underscore.

    Raises:
        CheckFailed: a space changes, or differs within a group.
    """
    with closing(short_race(make_env)()) as env:
        first = {(kind, a): getattr(env, kind)(a) for a in env.possible_agents for kind in _KINDS}
        _check_same(env, first, "before reset()")
        for step in play(env, 1, max_steps=3):
            _check_same(env, first, f"at step {step.number}")
            strangers = [agent for agent in step.agents if agent not in env.possible_agents]
            expect(not strangers, f"agents {strangers} are not among possible_agents")
        _check_groups(first)


def check_observations_are_in_their_spaces(make_env: EnvFactory) -> None:
    """Every observation of a whole race is in its agent's space, including the last ones.

    Raises:
        CheckFailed: an observation is not; the message names agent, step and key.
    """
    with closing(whole_race(make_env)()) as env:
        for step in play(env, 2):
            for agent, observation in step.observations.items():
                path = f"step {step.number}: observations[{agent!r}]"
                expect_in(env.observation_space(agent), observation, path)


def check_state_is_in_its_space(make_env: EnvFactory) -> None:
    """``state()`` is in ``state_space`` at every step of a whole race, as a new array.

    Raises:
        CheckFailed: the state is not in the space, or an array is reused.
        NotApplicable: the environment has no ``state_space``.
    """
    with closing(whole_race(make_env)()) as env:
        space = getattr(env, "state_space", None)
        if space is None:
            raise NotApplicable("the environment has no state_space")
        previous: Any = None
        for step in play(env, 3):
            state = env.state()
            expect_in(space, state, f"step {step.number}: state()")
            expect(
                not np.shares_memory(state, previous if previous is not None else env.state()),
                f"step {step.number}: state() shares memory with an earlier state; expected a "
                "fresh array each time",
            )
            previous = state


def _check_same(env: Env, first: dict[tuple[str, Any], Any], when: str) -> None:
    for (kind, agent), space in first.items():
        expect(
            getattr(env, kind)(agent) is space,
            f"{kind}({agent!r}) is another object {when} than at first; expected the same one each "
            "time, so that seeding it has an effect",
        )


def _check_groups(spaces: dict[tuple[str, Any], Any]) -> None:
    leaders: dict[tuple[str, str], Any] = {}
    for (kind, agent), space in spaces.items():
        group = re.sub(r"_\d+$", "", str(agent))
        leader = leaders.setdefault((kind, group), agent)
        expect(
            space == spaces[kind, leader],
            f"{kind}({agent!r}) differs from {kind}({leader!r}): {space} and "
            f"{spaces[kind, leader]}; expected equal spaces in a group of like names",
        )


def check_infos_are_plain_numbers(make_env: EnvFactory) -> None:
    """Infos are new dicts of numbers, with the same keys for all agents in every step.

    Raises:
        CheckFailed: an info differs from that; the message names agent, step and key.
    """
    keys: list[Any] | None = None
    seen: list[Any] = []  # kept alive, so that ids are not reused
    with closing(whole_race(make_env)()) as env:
        for step in play(env, 10):
            for agent, info in step.infos.items():
                where = f"step {step.number}: infos[{agent!r}]"
                expect(
                    not any(info is other for other in seen[-64:]),
                    f"{where} is a dict handed out before; expected a fresh one",
                )
                seen.append(info)
                keys = list(info) if keys is None else keys
                expect(
                    set(info) == set(keys),
                    f"{where} has the keys {sorted(map(str, info))}, expected those of the first "
                    f"info: {sorted(map(str, keys))}",
                )
                _check_numbers(info, where)


def check_results_share_no_memory(make_env: EnvFactory) -> None:
    """No two arrays share memory, across agents, steps, results and actions.

    Raises:
        CheckFailed: two arrays share memory; the message names both.
    """
    found: list[tuple[str, np.ndarray[Any, Any]]] = []
    with closing(short_race(make_env)()) as env:
        for step in play(env, 11, max_steps=_NUM_STEPS):
            for name, part in {"actions": step.actions, **step.parts}.items():
                found.extend(arrays_in(part, f"step {step.number}: {name}"))
    for (path, array), (other_path, other) in _overlaps(found):
        raise CheckFailed(
            f"{path} {array.shape} shares memory with {other_path} {other.shape}; expected "
            "arrays of their own"
        )


def check_results_are_the_callers_own(make_env: EnvFactory) -> None:
    """Results do not change later, and overwriting them does not affect the race.

    The same holds for actions: the environment does not change them, and later changes have no
    effect.

    Raises:
        CheckFailed: a value changed.
    """
    with closing(short_race(make_env)()) as env:
        expected = trace(play(env, 12, max_steps=_NUM_STEPS))
        last: Step | None = None
        content = ""
        for step in play(env, 12, max_steps=_NUM_STEPS, policy=_Watched(env)):
            expect(
                last is None or fingerprint(last.parts) == content,
                f"step {step.number} changed what step {step.number - 1} had returned; expected "
                "arrays that stay as they are",
            )
            last, content = step, fingerprint(step.parts)
        spoiled = trace(_spoiling(play(env, 12, max_steps=_NUM_STEPS)))
    expect_equal(expected, spoiled, "races with results left alone and overwritten by the caller")


class _Watched(RandomPolicy):
    """Detects whether the environment changes the actions of the last step."""

    _last: tuple[dict[Any, Any], dict[Any, Any]] | None = None

    def __call__(self, step: Step) -> dict[Any, Any]:
        expect(
            self._last is None or fingerprint(self._last[0]) == fingerprint(self._last[1]),
            f"step {step.number} changed the actions that were passed to it; expected them to be "
            "left alone",
        )
        actions = super().__call__(step)
        self._last = actions, copy.deepcopy(actions)
        return actions


def _check_numbers(info: Mapping[Any, Any], where: str) -> None:
    for key, value in info.items():
        is_number = isinstance(value, (bool, int, float, np.generic, np.ndarray))
        expect(
            is_number and np.asarray(value).dtype.kind in "biuf",
            f"{where}[{key!r}] is {value!r} of type {type(value).__name__}, expected a number; "
            "names belong elsewhere, since learners stack infos",
        )


def _spoiling(steps: Iterator[Step]) -> Iterator[Step]:
    """Yields the steps and overwrites their values once they are recorded."""
    for step in steps:
        yield step
        for _, array in arrays_in([step.actions, step.parts], ""):
            if array.flags.writeable:
                array.fill(0 if array.dtype.kind in "US" else 77)
        for part in step.parts.values():
            for entry in part.values():
                if isinstance(entry, dict):
                    entry.clear()
            part.clear()


def _overlaps(arrays: list[tuple[str, np.ndarray[Any, Any]]]) -> Iterator[tuple[Any, Any]]:
    """Yields pairs of arrays that share memory, the later one first."""
    spans = sorted(
        (*np.lib.array_utils.byte_bounds(array), number)
        for number, (_, array) in enumerate(arrays)
        if array.size
    )
    active: list[tuple[int, int]] = []  # end and number of arrays that may still overlap
    for start, end, number in spans:
        active = [(other_end, other) for other_end, other in active if other_end > start]
        for _, other in active:
            if np.shares_memory(arrays[number][1], arrays[other][1]):
                yield arrays[max(number, other)], arrays[min(number, other)]
        active.append((end, number))
