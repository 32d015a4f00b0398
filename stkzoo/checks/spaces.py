"""Checks of the spaces and of what must be in them."""

from __future__ import annotations

import re
from contextlib import closing
from typing import Any

import numpy as np

from stkzoo.checks.factory import EnvFactory, short_race, whole_race
from stkzoo.checks.failure import CheckFailed, NotApplicable
from stkzoo.checks.membership import fault_in
from stkzoo.checks.play import Env, play

__all__ = [
    "check_observations_are_in_their_spaces",
    "check_spaces_are_constant",
    "check_state_is_in_its_space",
]

_KINDS = ("observation_space", "action_space")


def check_spaces_are_constant(make_env: EnvFactory) -> None:
    """Every agent's spaces are the same objects before reset and after, equal in a group.

    A group is what learners take for one: agents whose names differ in the number after
    the last underscore alone.

    Raises:
        CheckFailed: they are not.
    """
    with closing(short_race(make_env)()) as env:
        first = {(kind, a): getattr(env, kind)(a) for a in env.possible_agents for kind in _KINDS}
        _check_same(env, first, "before reset()")
        for step in play(env, 1, max_steps=3):
            _check_same(env, first, f"at step {step.number}")
            strangers = [agent for agent in step.agents if agent not in env.possible_agents]
            if strangers:
                raise CheckFailed(f"agents {strangers} are not among possible_agents")
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
                fault = fault_in(env.observation_space(agent), observation, path)
                if fault:
                    raise CheckFailed(fault)


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
            fault = fault_in(space, state, f"step {step.number}: state()")
            if fault:
                raise CheckFailed(fault)
            if np.shares_memory(state, previous if previous is not None else env.state()):
                raise CheckFailed(
                    f"step {step.number}: state() shares memory with an earlier state; "
                    "expected a fresh array each time"
                )
            previous = state


def _check_same(env: Env, first: dict[tuple[str, Any], Any], when: str) -> None:
    for (kind, agent), space in first.items():
        if getattr(env, kind)(agent) is not space:
            raise CheckFailed(
                f"{kind}({agent!r}) is another object {when} than at first; expected the same "
                "one each time, so that seeding it has an effect"
            )


def _check_groups(spaces: dict[tuple[str, Any], Any]) -> None:
    leaders: dict[tuple[str, str], Any] = {}
    for (kind, agent), space in spaces.items():
        group = re.sub(r"_\d+$", "", str(agent))
        leader = leaders.setdefault((kind, group), agent)
        if space != spaces[kind, leader]:
            raise CheckFailed(
                f"{kind}({agent!r}) differs from {kind}({leader!r}): {space} and "
                f"{spaces[kind, leader]}; expected equal spaces in a group of like names"
            )
