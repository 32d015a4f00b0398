"""Checks of the spaces, and of the values that must be in them."""

from __future__ import annotations

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
    expect,
    play,
    short_race,
    whole_race,
)


def expect_in(space: spaces.Space[Any], value: Any, path: str) -> None:
    """Checks that a value is in a space.

    Stricter than ``space.contains``: arrays must have the space's own dtype.

    Args:
        space: the space.
        value: the value.
        path: what the value is called in the text.

    Raises:
        CheckFailed: it is not.
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
        for number, entry in enumerate(value):
            expect_in(space.feature_space, entry, f"{path}[{number}]")
    elif isinstance(value, np.ndarray) and space.dtype is not None and value.dtype != space.dtype:
        raise CheckFailed(f"{path} has dtype {value.dtype}, expected {space.dtype}")
    elif not space.contains(value):
        raise CheckFailed(f"{path} is {reprlib.repr(value)}, expected a value of {space}")


def arrays_in(value: Any, path: str) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """All arrays inside nested dicts, tuples and lists, with their paths."""
    if isinstance(value, np.ndarray):
        yield path, value
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            yield from arrays_in(entry, f"{path}[{key!r}]")
    elif isinstance(value, (tuple, list)):
        for number, entry in enumerate(value):
            yield from arrays_in(entry, f"{path}[{number}]")


_KINDS = ("observation_space", "action_space")


def check_spaces_are_constant(make_env: EnvFactory) -> None:
    """Every agent's spaces are the same objects before reset and after, equal in a group.

    Learners group agents whose names differ only in the number after the last underscore.

    Raises:
        CheckFailed: they are not.
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
    """Every observation of a whole race is in its agent's space, the last ones included.

    Raises:
        CheckFailed: one is not; the text names agent, step and key.
    """
    with closing(whole_race(make_env)()) as env:
        for step in play(env, 2):
            for agent, observation in step.observations.items():
                path = f"step {step.number}: observations[{agent!r}]"
                expect_in(env.observation_space(agent), observation, path)


def check_state_is_in_its_space(make_env: EnvFactory) -> None:
    """``state()`` is in ``state_space`` at every step of a whole race, in an array of its own.

    Raises:
        CheckFailed: it is not.
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
