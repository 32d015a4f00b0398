"""Races that repeat a few starts."""

import copy
import os
import pickle
import signal
from contextlib import ExitStack, closing

import numpy as np
import pytest

from stkzoo import RaceVectorEnv
from stkzoo.env.vec.starts import AheadStarts
from stkzoo.errors import ConfigError
from stkzoo.names import Phase
from tests.support.processes import process_exists, wait_until

RACE = {"num_kart": 2, "agents": 2, "track": "lighthouse", "view": "racing", "max_cycles": 5}


@pytest.fixture
def make():
    """Makes environments, and closes them after the test."""
    with ExitStack() as stack:

        def make(num_starts=2, **options):
            envs = RaceVectorEnv(2, num_starts=num_starts, **RACE | options)
            return stack.enter_context(closing(envs))

        yield make


def drive(envs, seed, steps=30):
    """Returns all observations and rewards of a run over several races."""
    observations, _ = envs.reset(seed=seed)
    envs.action_space.seed(0)
    seen = [observations]
    for _ in range(steps):
        observations, rewards, *_ = envs.step(envs.action_space.sample())
        seen += [observations, rewards]
    return seen


def waiting(envs):
    return [session.pid for session, _ in envs._repeated._kept.values()]


def engine_seeds(envs):
    return [race.race.seed for race in envs.races]


def test_a_few_starts_are_kept_and_repeated(make):
    envs = make(num_starts=3)
    envs.reset(seed=1)
    met = set(engine_seeds(envs))
    for _ in range(12):
        for _ in range(5):
            envs.step(envs.action_space.sample())
        met |= set(engine_seeds(envs))
    assert len(met) == 3
    assert len(waiting(envs)) == 3


@pytest.mark.slow
def test_a_copied_start_gives_the_same_race_as_a_new_one(make):
    copied, started = make(), make()
    for race in started.races:
        race.live_race.starts = AheadStarts(race.live_race.new_session)  # the same seeds
    for ours, theirs in zip(drive(copied, 3), drive(started, 3), strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["before", "amid"])
@pytest.mark.parametrize("library", [copy.deepcopy, lambda envs: pickle.loads(pickle.dumps(envs))])
def test_a_copied_environment_repeats_the_same_starts(make, moment, library):
    envs = make()
    if moment == "amid":
        drive(envs, 3)
    with closing(library(envs)) as again:
        for ours, theirs in zip(drive(again, 3), drive(envs, 3), strict=True):
            np.testing.assert_array_equal(ours, theirs)
        assert len(waiting(again)) == 2
        assert not set(waiting(again)) & set(waiting(envs))


@pytest.mark.slow
def test_the_seed_determines_the_starts(make):
    envs = make()
    first, again, other = drive(envs, 1), drive(envs, 1), drive(envs, 2)
    assert all((a == b).all() for a, b in zip(first, again, strict=True))
    assert any((a != b).any() for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize("seed", [None, [None, None]])
def test_a_reset_without_seeds_keeps_the_starts(make, seed):
    envs = make()
    drive(envs, 1)
    met = set(waiting(envs))
    assert len(met) == 2
    for _ in range(4):
        envs.reset(seed=seed)
    assert set(waiting(envs)) == met


@pytest.mark.slow
def test_new_options_apply_to_the_next_races_and_old_starts_end(make):
    envs = make(num_starts=2)
    drive(envs, 1)
    before = waiting(envs)
    envs.set_options({"track": "hacienda"})
    for _ in range(30):
        envs.step(envs.action_space.sample())
    assert {race.race.track for race in envs.races} == {"hacienda"}
    assert len(waiting(envs)) == 2
    assert wait_until(lambda: not any(map(process_exists, before)))


@pytest.mark.slow
def test_a_start_that_was_killed_is_started_again(make):
    envs, other = make(num_starts=1), make(num_starts=1)
    drive(envs, 1)
    (pid,) = waiting(envs)
    os.kill(pid, signal.SIGKILL)
    assert wait_until(lambda: not process_exists(pid))
    for ours, theirs in zip(drive(envs, 1), drive(other, 1), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert envs.num_crashes == 0


def test_closing_ends_the_starts(make):
    envs = make()
    drive(envs, 1)
    pids = waiting(envs)
    envs.close()
    assert pids
    assert wait_until(lambda: not any(map(process_exists, pids)))


def test_a_set_of_starts_with_a_seed_stays_the_same_when_their_order_changes(make):
    envs = make(num_starts=3, start_seed=5)
    met = []
    for seed in range(6):
        envs.reset(seed=seed)
        met.append(tuple(engine_seeds(envs)))
    assert len(set(met)) > 1
    assert len({seed for pair in met for seed in pair}) <= 3


def test_races_can_skip_the_countdown(make):
    envs = make(num_starts=1, skip_countdown=True, view="simple")
    for _ in range(2):  # the second start is a copy
        observations, _ = envs.reset(seed=1)
        assert set(observations["phase"].tolist()) == {Phase.GO_PHASE}
    with pytest.raises(ConfigError, match="need num_starts"):
        RaceVectorEnv(1, skip_countdown=True, **RACE)


@pytest.mark.parametrize("number", [0, -1, 1.5, "many"])
def test_invalid_numbers_of_starts_are_refused(make, number):
    with pytest.raises(ConfigError, match="num_starts"):
        make(num_starts=number)


def test_num_starts_is_an_error_where_races_cannot_be_copied(make, monkeypatch):
    monkeypatch.setenv("STKZOO_START_METHOD", "spawn")
    with pytest.raises(ConfigError, match="only on Linux without STKZOO_START_METHOD=spawn"):
        make()
