"""A seed determines the whole race, including the bots, in every process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import cloudpickle
import pytest

from stkzoo import AgentSpec, EngineCrashed, race_v0
from stkzoo.checks import first_difference, play, trace
from stkzoo.checks.processes import descendants, run_fresh
from tests.support.paths import ROOT

# A new process cannot import functions from a test module.
cloudpickle.register_pickle_by_value(sys.modules[__name__])

SHORT_TRACKS = ("olivermath",)


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    output = tmp_path_factory.mktemp("determinism") / "report.json"
    command = [sys.executable, "-m", "benchmarks.determinism", "--track", *SHORT_TRACKS]
    run = subprocess.run([*command, "--output", output], capture_output=True, text=True, cwd=ROOT)
    assert run.returncode == 0, run.stdout + run.stderr
    return {result["track"]: result for result in json.loads(output.read_text())["tracks"]}


@pytest.mark.slow
@pytest.mark.parametrize("track", SHORT_TRACKS)
def test_all_agents_finish_the_compared_race(report, track):
    assert report[track]["finished"] == 3


@pytest.mark.parametrize("track", SHORT_TRACKS)
def test_a_seed_repeats_bit_for_bit_in_one_environment(report, track):
    assert report[track]["same_env"] == ""


@pytest.mark.parametrize("track", SHORT_TRACKS)
def test_a_seed_repeats_bit_for_bit_in_another_environment(report, track):
    assert report[track]["other_env"] == ""


@pytest.mark.parametrize("track", SHORT_TRACKS)
def test_a_seed_repeats_bit_for_bit_in_a_new_program(report, track):
    assert report[track]["fresh_program"] == ""


@pytest.mark.parametrize("track", SHORT_TRACKS)
def test_another_seed_gives_another_race(report, track):
    assert report[track]["other_seed_differs"]


def make(**options):
    agents = [AgentSpec(), AgentSpec(use_ai=True)]
    options = {"agents": agents, "num_kart": 4, "track": "olivermath", **options}
    return race_v0.parallel_env(**options, max_cycles=330, view="simple")


def race(env, seed=5, max_steps=None):
    return trace(play(env, seed, max_steps=max_steps))


@pytest.mark.slow
def test_a_seed_repeats_after_the_game_was_killed_during_a_race():
    with make() as env:
        expected = race(env)
        others = descendants()
        for step in play(env, 6, max_steps=50):
            assert step.agents
        (worker,) = descendants() - others
        os.kill(worker, signal.SIGKILL)
        with pytest.raises(EngineCrashed):
            env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        assert first_difference(expected, race(env)) is None


@pytest.mark.slow
def test_a_spawned_process_drives_the_same_race_as_a_forked_one(monkeypatch):
    with make() as env:
        forked = race(env)
    monkeypatch.setenv("STKZOO_START_METHOD", "spawn")
    with make() as env:
        assert first_difference(forked, race(env)) is None


@pytest.mark.slow
def test_the_game_in_this_process_drives_the_same_first_race():
    with make() as env:
        expected = race(env)
    assert first_difference(expected, run_fresh(first_race_in_this_process)[0]) is None


def first_race_in_this_process():
    with make(use_subprocess=False) as env:
        return race(env)


@pytest.mark.slow
def test_an_episode_with_other_options_does_not_affect_the_next():
    with make() as env:
        expected = race(env, max_steps=60)
        trace(play(env, 5, max_steps=20, options={"track": "zengarden", "laps": 2}))
        assert first_difference(expected, race(env, max_steps=60)) is None


@pytest.mark.slow
def test_the_reward_does_not_change_the_race():
    with make() as plain, make(reward="placement") as other:
        for _ in zip(play(plain, 8), play(other, 8), strict=True):
            assert (plain.state() == other.state()).all()
