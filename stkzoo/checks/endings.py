"""Checks of who acts, who leaves and what an end looks like."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

from stkzoo.checks.play import (
    PARTS,
    CheckFailed,
    EnvFactory,
    NotApplicable,
    RandomPolicy,
    Step,
    expect,
    expect_equal,
    fingerprint,
    play,
    trace,
    whole_race,
)


def check_keys_are_the_acting_agents(make_env: EnvFactory) -> None:
    """All dicts have exactly the keys of the agents that acted, on their last step too.

    Raises:
        CheckFailed: an agent is missing or too many; the text names it, step and dict.
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
    """Agents start in the order of ``possible_agents``, leave on their end and stay away.

    Raises:
        CheckFailed: an agent leaves at another time, or comes back.
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
    """Rewards are Python's ``float`` and finite, both ends Python's ``bool`` and not both true.

    Raises:
        CheckFailed: one is of another type.
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
    """After the first agents' end the race moves on for the rest, and pays the others nothing.

    Raises:
        CheckFailed: the rest stands still, or a departed agent is still served.
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
    """``step`` after the end returns five empty dicts, with and without actions.

    Raises:
        CheckFailed: it returns something, or raises.
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
    """A race in which departed agents still send actions is the same race.

    Raises:
        CheckFailed: it is another one, or an action was refused.
        NotApplicable: all agents ended in the same step.
    """
    with closing(whole_race(make_env)()) as env:
        lengths = {}
        recorded = []
        quiet = RandomPolicy(env, with_departed=True)
        for step in play(env, 9, policy=lambda s: _only(quiet(s), s.agents)):
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


def _only(actions: dict[Any, Any], agents: tuple[Any, ...]) -> dict[Any, Any]:
    return {agent: actions[agent] for agent in agents}
