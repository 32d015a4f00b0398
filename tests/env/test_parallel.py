"""The phases of a step: their order, and that none calls back into another."""

from __future__ import annotations

import sys

import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.engine.session import WorkerSession
from stkzoo.env.episode import Episode
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.views import AgentChains

PHASES = [
    (AgentChains, "decode"),
    (WorkerSession, "step_async"),
    (WorkerSession, "step_wait"),
    (Episode, "advance"),
    (AgentChains, "observe"),
    (Episode, "infos"),
    (AgentChains, "finish"),
]


@pytest.fixture
def phases(monkeypatch):
    """What begins and ends in a step, in order."""
    seen = []

    def recorded(name, method):
        def call(*args, **kwargs):
            seen.append(f"{name} begins")
            result = method(*args, **kwargs)
            seen.append(f"{name} ends")
            return result

        return call

    for owner, name in PHASES:
        monkeypatch.setattr(owner, name, recorded(name, getattr(owner, name)))
    return seen


def actions_of(env):
    return {agent: env.action_space(agent).sample() for agent in env.agents}


@pytest.mark.parametrize("view", ["full", "masked_discrete", "flattened_control"])
def test_a_step_is_its_phases_one_after_another(phases, view):
    with race_v0.parallel_env(num_kart=2, track="lighthouse", view=view) as env:
        env.reset(seed=1)
        actions = actions_of(env)
        phases.clear()
        env.step(actions)
        assert phases == [f"{name} {when}" for _, name in PHASES for when in ("begins", "ends")]


def modules_of_a_step(env):
    """The package's files that a step passes through."""
    root, seen = stkzoo.__path__[0], set()
    home = root.removesuffix("stkzoo")
    actions = actions_of(env)

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_filename.startswith(home):
            seen.add(frame.f_code.co_filename.removeprefix(home))

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        env.step(actions)
    finally:
        sys.setprofile(before)
    return {name for name in seen if not name.startswith("tests")}


def test_a_default_step_passes_at_most_six_modules():
    with race_v0.parallel_env(num_kart=2, track="lighthouse") as env:
        env.reset(seed=1)
        env.step(actions_of(env))
        assert len(modules_of_a_step(env)) <= 6


def test_the_parallel_step_is_its_two_halves():
    """Vector environments call these by themselves, for all races before any waits."""
    with race_v0.parallel_env(num_kart=2, track="lighthouse") as env:
        env.reset(seed=1)
        actions = actions_of(env)
        state = env.save_state()
        _, *whole = env.step(actions)
        env.restore_state(state)
        RaceParallelEnv.step_async(env, actions)
        _, *halves = env.step_wait()
        assert whole == halves
        state.close()
