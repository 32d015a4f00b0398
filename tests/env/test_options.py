"""The race mode, on the real engine and in all kinds of environments."""

import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo.errors import ConfigError
from stkzoo.names import ItemType, PowerupType
from tests.support.playing import kart_action

SMALL = {"num_kart": 2, "track": "lighthouse", "laps": 3, "max_paths": 5}


def race(**options):
    return race_v0.parallel_env(**SMALL | options)


def boxes(env):
    return int((env.snapshot.items["type"] == ItemType.BONUS_BOX).sum())


def test_a_time_trial_has_no_item_boxes_and_a_zipper_per_lap():
    with race(mode="time_trial") as env:
        env.reset(seed=1)
        karts = env.snapshot.karts
        assert env.race.mode == "time_trial"
        assert boxes(env) == 0
        assert karts["powerup_type"].tolist() == [PowerupType.ZIPPER] * 2
        assert karts["powerup_num"].tolist() == [3, 3]


@pytest.mark.parametrize("mode", ["timetrial", 1])
def test_an_unknown_mode_is_refused_and_the_error_lists_the_known_ones(mode):
    with pytest.raises(ConfigError, match=r"unknown mode .* Known: normal, time_trial"):
        race(mode=mode)


def test_reset_changes_the_mode_for_one_episode():
    with race() as env:
        found = []
        for options in ({"mode": "time_trial"}, {}):
            env.reset(seed=1, options=options)
            found.append((env.race.mode, boxes(env) > 0))
        assert found == [("time_trial", False), ("normal", True)]


def test_a_scenario_keeps_the_mode(tmp_path):
    path = tmp_path / "moment.zip"
    with race(mode="time_trial") as env:
        env.reset(seed=3)
        for _ in range(30):
            env.step(dict.fromkeys(env.agents, kart_action(1.0)))
        env.scenario().save(path)
        here = env.snapshot.karts["location"].tobytes()
    with race() as env:
        env.reset(options={"scenario": stkzoo.Scenario.load(path)})
        assert env.race.mode == "time_trial"
        assert env.snapshot.karts["location"].tobytes() == here
