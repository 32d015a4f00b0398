"""A seed determines the whole race, including the bots, in every process."""

import json
import os

import numpy as np
import pytest

from stkzoo import AgentSpec, race_v0
from stkzoo.agents.heuristic import create_state, get_actor
from stkzoo.tracks import SPLITS
from tests.support.paths import ROOT
from tests.support.playing import fingerprint, play, trace
from tests.support.processes import run_program
from tests.support.views import marked

pytestmark = pytest.mark.slow


class NoisyDrivers:
    """A heuristic driver for each agent, with noise on the steering and random shots."""

    def __init__(self):
        self._drive = get_actor(None, None, None)

    def __call__(self, step):
        if step.number == 0:
            self._states = {agent: create_state() for agent in step.agents}
            self._random = {a: np.random.default_rng([0, i]) for i, a in enumerate(step.agents)}
        return {agent: self._act(agent, step.observations[agent]) for agent in step.agents}

    def _act(self, agent, observation):
        action = self._drive(self._states[agent], observation)
        random = self._random[agent]
        steer = np.asarray(action["steer"], np.float32) + random.normal(0.0, 0.05)
        steer = np.clip(steer, -1.0, 1.0).astype(np.float32)
        return {**action, "steer": steer, "fire": int(random.random() < 0.1)}


def make_whole(track):
    """Makes races of three agents and three bots to the finish."""
    return race_v0.parallel_env(agents=3, num_kart=6, track=track, max_paths=60, max_cycles=4000)


def drive(env, seed):
    """Drives a race; returns its trace, with the state, and how many agents finished."""
    finished, record = 0, []
    for step in play(env, seed, policy=NoisyDrivers()):
        finished += sum(step.terminations.values())
        record += trace([step])
        record.append(fingerprint(env.state()))
    return record, finished


def drive_in_a_new_environment(track, seed):
    with make_whole(track) as env:
        return drive(env, seed)[0]


def in_a_new_program(call):
    """Returns the value of a function of this module in a new program with another hash seed."""
    code = f"""
        import json
        from tests.env.test_determinism import *
        print(json.dumps({call}))
    """
    done = run_program(code, cwd=ROOT, env={**os.environ, "PYTHONHASHSEED": "1"}, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])  # the game's own lines come first


@pytest.mark.parametrize("track", marked(SPLITS["all"], ("olivermath",)))
def test_a_seed_repeats_a_whole_race_bit_for_bit(track):
    with make_whole(track) as env:
        first, finished = drive(env, 1)
        other, _ = drive(env, 2)
        again, _ = drive(env, 1)
    assert finished == 3
    assert other != first
    assert again == first, "in one environment"
    assert drive_in_a_new_environment(track, 1) == first
    assert in_a_new_program(f"drive_in_a_new_environment({track!r}, 1)") == first


def make(**options):
    agents = [AgentSpec(), AgentSpec(use_ai=True)]
    options = {"agents": agents, "num_kart": 4, "track": "olivermath", **options}
    return race_v0.parallel_env(**options, max_cycles=330, view="flattened_discrete")


def race(env, seed=5, **options):
    return trace(play(env, seed, **options))


def test_a_spawned_process_drives_the_same_race_as_a_forked_one(monkeypatch):
    with make() as env:
        forked = race(env)
    monkeypatch.setenv("STKZOO_START_METHOD", "spawn")
    with make() as env:
        assert race(env) == forked


def test_the_game_in_this_process_drives_the_same_first_race():
    with make() as env:
        expected = race(env)
    assert in_a_new_program("first_race_in_this_process()") == expected


def first_race_in_this_process():
    with make(use_subprocess=False) as env:
        return race(env)


def test_an_episode_with_other_options_does_not_affect_the_next():
    with make() as env:
        expected = race(env, max_steps=60)
        race(env, max_steps=20, options={"track": "zengarden", "laps": 2})
        assert race(env, max_steps=60) == expected


def test_the_reward_does_not_change_the_race():
    with make() as plain, make(reward="placement") as other:
        for _ in zip(play(plain, 8), play(other, 8), strict=True):
            assert (plain.state() == other.state()).all()
