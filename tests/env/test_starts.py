"""Races that start anywhere on the track, and scenario files."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

from stkzoo import (
    AgentSpec,
    ApiOrderError,
    ConfigError,
    EngineError,
    RandomStart,
    Scenario,
    Start,
    race_v0,
)
from stkzoo.engine.starting import CenterLine
from stkzoo.env.starts import draw_starts
from tests.support.playing import kart_action


def race(num_kart=1, track="lighthouse", **options):
    return race_v0.parallel_env(num_kart=num_kart, track=track, **options)


def expected_point(env, start):
    """Returns the point of a start, computed from the track's arrays."""
    track = env.track_map
    distance = (start.share or 0) * track.length if start.distance is None else start.distance
    distance -= start.behind
    marks, node = track.path_distance, 0
    while not marks[node, 0] <= distance % track.length <= marks[node, 1]:
        node = track.successors[node][0]
    share = (distance % track.length - marks[node, 0]) / (marks[node, 1] - marks[node, 0])
    begin, end = track.path_nodes[node].astype(float)
    along = (end - begin) / np.linalg.norm((end - begin)[[0, 2]])
    return begin + share * (end - begin) + start.offset * np.array([along[2], 0.0, -along[0]])


def coast(env, steps, throttle=0.0):
    states = []
    for _ in range(steps):
        env.step(dict.fromkeys(env.agents, kart_action(throttle)))
        states.append(env.state())
    return np.array(states)


# ------------------------------------------------------------------ on the real engine


@pytest.mark.parametrize(
    ("track", "start"),
    [
        ("lighthouse", Start(distance=30.0)),
        ("lighthouse", Start(distance=400.0, speed=15.0, offset=2.0)),
        ("lighthouse", Start(distance=870.0, speed=np.float32(3.0), heading=0.4)),
        ("olivermath", Start(share=0.3, offset=-3.0)),
        ("lighthouse", Start(distance=-10.0)),
    ],
)
def test_a_kart_starts_at_the_requested_place_and_speed(track, start):
    with race(track=track) as env:
        observations, _ = env.reset(seed=1, options={"start": start})
        assert env.observation_space("kart_0").contains(observations["kart_0"])
        kart = env.snapshot.karts[0]
        away = kart["location"] - expected_point(env, start)
        assert np.hypot(away[0], away[2]) < 1.0
        assert abs(away[1]) < 1.3
        assert kart["velocity_lc"][2] == pytest.approx(start.speed, abs=0.5)
        assert np.abs(kart["velocity_lc"][:2]).max() < 1.0
        assert kart["is_on_road"]
        laps = kart["finished_laps"]
        assert laps == (-1 if start.distance is not None and start.distance < 0 else 0)
        height = float(kart["location"][1])
        coast(env, 5)
        assert abs(float(env.snapshot.karts[0]["location"][1]) - height) < 2.0


def test_the_distance_matches_the_start():
    with race() as env:
        for distance in (5.0, 200.0, 700.0):
            _, infos = env.reset(seed=1, options={"start": distance})
            assert infos["kart_0"]["distance"] == pytest.approx(distance, abs=3.0)
            assert infos["kart_0"]["reward/advance"] == 0.0
            _, rewards, *_ = env.step({"kart_0": env.action_space("kart_0").sample()})
            assert abs(rewards["kart_0"]) < 5.0


def test_a_heading_turns_the_kart_to_the_right():
    with race() as env:
        fronts = []
        for heading in (0.0, 0.5):
            env.reset(seed=1, options={"start": Start(distance=300.0, heading=heading)})
            kart = env.snapshot.karts[0]
            fronts.append(kart["front"] - kart["location"])
        yaws = [np.arctan2(front[0], front[2]) for front in fronts]
        assert yaws[1] - yaws[0] == pytest.approx(0.5, abs=0.05)


def test_the_other_karts_start_in_rows_behind_the_first():
    agents = [AgentSpec(rank_start=1), AgentSpec(rank_start=2)]
    with race(num_kart=4, agents=agents, track="hacienda") as env:
        env.reset(seed=1, options={"start": Start(distance=400.0, speed=10.0)})
        karts = env.snapshot.karts
        along = karts["overall_distance"] - karts["overall_distance"][0]
        assert along == pytest.approx([0.0, 0.0, -4.0, -4.0], abs=1.5)
        assert karts["velocity_lc"][:, 2] == pytest.approx([10.0] * 4, abs=2.0)
        assert len({tuple(place) for place in karts["location"].round(1).tolist()}) == 4


def test_each_agent_has_its_own_start():
    with race(num_kart=3, agents=3, track="hacienda") as env:
        starts = {"kart_0": 700.0, 1: Start(distance=300.0, speed=8.0)}
        env.reset(seed=1, options={"start": starts})
        rows = env.snapshot.karts[list(env.race.kart_indices)]
        assert rows["overall_distance"] == pytest.approx([700.0, 300.0, 696.0], abs=8.0)
        assert rows["velocity_lc"][1, 2] == pytest.approx(8.0, abs=0.5)
        assert rows["velocity_lc"][0, 2] == pytest.approx(0.0, abs=0.5)


def test_tracks_can_be_driven_in_reverse():
    with race(reverse=True) as env:
        _, infos = env.reset(seed=1, options={"start": Start(distance=300.0, speed=10.0)})
        assert infos["kart_0"]["distance"] == pytest.approx(300.0, abs=3.0)
        coast(env, 5, throttle=0.5)
        assert env.infos(["kart_0"])["kart_0"]["distance"] > 303.0


@pytest.mark.slow
def test_the_same_seed_and_start_give_the_same_race():
    def play(env, seed):
        env.reset(seed=seed, options={"start": RandomStart(speed=(5.0, 15.0))})
        first = env.state()
        return np.concatenate([first[None], coast(env, 15, throttle=0.5)])

    with race(num_kart=3, agents=1) as env, race(num_kart=3, agents=1) as other:
        first = play(env, 7)
        assert np.array_equal(play(env, 7), first)
        assert np.array_equal(play(other, 7), first)
        assert not np.array_equal(play(env, 8), first)


def test_a_place_without_ground_is_refused_and_the_next_race_starts():
    with race() as env:
        env.reset(seed=1)
        half = CenterLine(env.track_map).half_width(300.0)
        with pytest.raises(ConfigError, match=r"20\.0 m from the center line .* has room for"):
            env.reset(options={"start": Start(distance=300.0, offset=20.0)})
        with pytest.raises(ConfigError, match=r"expected at most 879\.9 m, the length of the lap"):
            env.reset(options={"start": 5000.0})
        env.reset(options={"start": Start(distance=300.0, offset=half - 0.6)})
        coast(env, 2)


def test_speeds_above_the_top_speed_and_unknown_agents_are_refused():
    with race(difficulty=0) as env:
        for start, message in (
            (Start(distance=300.0, speed=25.0), "karts reach 15 m/s at difficulty 0"),
            ({"kart_7": 3.0}, "kart_7"),
        ):
            with pytest.raises(ConfigError, match=message):
                env.reset(seed=1, options={"start": start})


def test_starts_work_in_this_process_and_with_gymnasium():
    with race(use_subprocess=False) as env:
        env.reset(seed=1, options={"start": 300.0})
        assert env.snapshot.karts[0]["overall_distance"] == pytest.approx(300.0, abs=3.0)
        with pytest.raises(EngineError, match="use_subprocess"):
            env.save_state()
    with gym.make("supertuxkart/simple-v0", num_kart=1, track="lighthouse", start=440.0) as env:
        for options, distance in ((None, 440.0), ({"start": 100.0}, 100.0)):
            env.reset(seed=1, options=options)
            kart = env.unwrapped.core.snapshot.karts[0]
            assert kart["overall_distance"] == pytest.approx(distance, abs=3.0)


# ------------------------------------------------------------------ arguments


@pytest.mark.parametrize(
    ("make", "arguments", "message"),
    [
        (race, {"start": "grid?"}, "start is 'grid\\?', expected None for the grid"),
        (race, {"start": True}, "start is True"),
        (race, {"start": {}}, "empty mapping"),
        (race, {"start": float("nan")}, "distance of a start is nan"),
        (race, {"start": {"distanc": 3.0}}, "'distanc' of a start. Did you mean 'distance'"),
        (race, {"start": {"share": [0.5, 0.2]}}, r"expected \(lowest, highest\)"),
        (Start, {"distance": 1.0, "share": 0.5}, "either a distance"),
        (Start, {"share": 1.5}, "share of a start is 1.5"),
        (Start, {"share": 0.5, "speed": -1.0}, "speed of a start is -1"),
        (Start, {"share": 0.5, "heading": 4.0}, "heading of a start is 4"),
        (RandomStart, {"speed": 3.0}, r"speed is 3\.0"),
        (RandomStart, {"speed": (0.0, 50.0)}, "speed of a start is 50"),
    ],
)
def test_invalid_starts_are_refused_before_the_race(make, arguments, message):
    with pytest.raises(ConfigError, match=message):
        make(**arguments)


@pytest.mark.parametrize(
    "start",
    [
        300.0,
        RandomStart(share=(0.2, 0.4), speed=(5.0, 6.0)),
        {"kart_0": Start(distance=50.0, speed=12.0), "1": {"share": [0.1, 0.2]}},
    ],
)
def test_a_start_survives_json(start):
    make = {"num_kart": 2, "track": "lighthouse", "start": start, "agents": 2}
    with gym.make("supertuxkart/multi-full-v0", **make) as env:
        again = gym.make(EnvSpec.from_json(env.spec.to_json()))
        states = []
        for each in (env, again):
            each.reset(seed=1)
            states.append(each.unwrapped.core.state())
        again.close()
    np.testing.assert_array_equal(*states)


def test_random_starts_stay_within_their_bounds():
    wish = RandomStart(share=(0.2, 0.4), speed=(5.0, 6.0), offset=(-1.0, 1.0))
    random = np.random.default_rng(1)
    drawn = [draw_starts(wish, ["kart_0"], [0], 1, random)[0] for _ in range(200)]
    assert all(0.2 <= start.share <= 0.4 and 5.0 <= start.speed <= 6.0 for start in drawn)
    assert len({start.share for start in drawn}) == 200
    assert {start.heading for start in drawn} == {0.0}


# ------------------------------------------------------------------ scenarios


def test_a_scenario_file_continues_as_the_race_did(tmp_path):
    path = tmp_path / "hairpin.stkscene"
    options = {"num_kart": 3, "agents": 2}
    with race(**options) as env:
        env.reset(seed=5, options={"start": Start(distance=100.0, speed=5.0)})
        coast(env, 25, throttle=0.7)
        env.scenario().save(path)
        after = coast(env, 20, throttle=0.3)
    with race(**options) as env:
        observations, infos = env.reset(options={"scenario": path})
        assert set(observations) == {"kart_0", "kart_1"}
        assert infos["kart_0"]["episode/length"] == 0
        assert np.array_equal(coast(env, 20, throttle=0.3), after)
        again = env.scenario()
        assert len(again.controls) == 45
    assert Scenario.load(path).controls.shape == (25, 2, 7)
    assert [file.name for file in tmp_path.iterdir()] == ["hairpin.stkscene"]


def test_a_scenario_file_of_a_race_in_which_only_the_game_drives_keeps_its_steps(tmp_path):
    with race(agents=[AgentSpec(use_ai=True)]) as env:
        env.reset(seed=5)
        coast(env, 40)
        here = env.snapshot.data
        env.scenario().save(tmp_path / "ai.stkscene")
        env.reset(options={"scenario": tmp_path / "ai.stkscene"})
        assert env.snapshot.data == here
    assert Scenario.load(tmp_path / "ai.stkscene").controls.shape == (40, 0, 7)


def test_a_scenario_includes_the_steps_before_a_restored_state():
    with race() as env:
        env.reset(seed=5)
        coast(env, 25, throttle=1.0)
        with env.save_state() as state:
            coast(env, 10)
            env.restore_state(state)
        coast(env, 5, throttle=0.5)
        scenario = env.scenario()
        after = coast(env, 5, throttle=1.0)
        assert len(scenario.controls) == 30
        env.reset(options={"scenario": scenario})
        assert np.array_equal(coast(env, 5, throttle=1.0), after)


def test_invalid_scenarios_are_refused(tmp_path):
    bad = tmp_path / "bad.stkscene"
    bad.write_bytes(b"nothing")
    with race() as env:
        with pytest.raises(ApiOrderError, match="before reset"):
            env.scenario()
        env.reset(seed=1)
        scenario = env.scenario()
        with pytest.raises(ConfigError, match="cannot be read"):
            env.reset(options={"scenario": bad})
        with pytest.raises(ConfigError, match="cannot be read"):
            env.reset(options={"scenario": tmp_path / "none"})
        with pytest.raises(ConfigError, match="scenario is 3"):
            env.reset(options={"scenario": 3})
        with pytest.raises(ConfigError, match="a scenario and track"):
            env.reset(options={"scenario": scenario, "track": "mines"})
        with pytest.raises(ConfigError, match="cannot be written"):
            scenario.save(tmp_path / "no" / "folder")
    with race(num_kart=2) as env, pytest.raises(ConfigError, match="1 karts and 1 agents"):
        env.reset(options={"scenario": scenario})


def test_a_scenario_that_does_not_reproduce_its_race_is_an_error():
    with race() as env:
        env.reset(seed=1)
        coast(env, 30, throttle=1.0)
        scenario = env.scenario()
        changed = scenario.controls.copy()
        changed[25:, 0, 0] = 0.0
        fields = {name: getattr(scenario, name) for name in ("setup", "kart_indices", "agents")}
        other = Scenario(**fields, controls=changed, digest=scenario.digest)
        with pytest.raises(ConfigError, match="does not repeat as recorded"):
            env.reset(options={"scenario": other})
        env.reset(seed=1)


@pytest.mark.matrix
def test_a_random_start_that_is_refused_is_drawn_again():
    wish = RandomStart(share=(0.3, 0.3), offset=(-20.0, 20.0))
    with race() as env:
        for seed in range(3):
            env.reset(seed=seed, options={"start": wish})
            (start,) = env.live_race.episode.setup.starts
            assert abs(start.offset) < 6.0
            assert env.snapshot.karts[0]["is_on_road"]
        beside = RandomStart(share=(0.3, 0.3), offset=(18.0, 20.0))
        with pytest.raises(ConfigError, match="from the center line"):
            env.reset(seed=1, options={"start": beside})
