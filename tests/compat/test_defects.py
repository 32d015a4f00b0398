"""Defects of pystk2-gymnasium 0.10.0 that stkzoo does not have, tested on the real game."""

import re
import subprocess
import sys
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stkzoo
from stkzoo import AgentSpec, ConfigError, MonoAgentWrapperAdapter, race_v0
from stkzoo.engine.snapshot import HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.mdp.rewards import as_reward
from stkzoo.mdp.spaces import kart_observation_space
from stkzoo.mdp.transition import Transition
from stkzoo.wrappers import Discretizer
from tests.support.generic_env import Counter, moment_of, observe_full
from tests.support.paths import ROOT
from tests.support.playing import kart_action
from tests.support.rewards import values_of
from tests.support.views import EACH_ID, marked

MULTI_ID = "supertuxkart/multi-full-v0"
SHORT_TRACK = "lighthouse"
#: Number of steps after which karts have moved.
UNTIL_MOVING = 45


def idle(env):
    """Returns actions that do nothing."""
    return {agent: kart_action() for agent in env.agents}


def specs(kinds):
    """Returns one agent per letter: ``a`` is driven by the game's AI, ``p`` by its actions."""
    return [AgentSpec(use_ai=kind == "a") for kind in kinds]


def leaves(value):
    """Returns the arrays and numbers in nested dicts."""
    if isinstance(value, dict):
        return [leaf for part in value.values() for leaf in leaves(part)]
    return [np.asarray(value)]


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(leaves(a), leaves(b), strict=True))


@pytest.fixture(scope="module")
def finished_race():
    """Runs three AI agents to the finish as a dict of agents; returns all steps and final ranks."""
    env = gym.make(MULTI_ID, agents=specs("aaa"), num_kart=3, track=SHORT_TRACK)
    env.reset(seed=0)
    steps = [env.step({})]
    while not (steps[-1][2] or steps[-1][3]):
        steps.append(env.step({}))
    positions = env.unwrapped.core.snapshot.karts["position"]
    indices = env.unwrapped.kart_indices
    env.close()
    return steps, [int(positions[kart]) for kart in indices]


# ------------------------------------------------------------------------------------ D01


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds", marked(["pp", "ppp", "app", "pap", "ppa", "papa", "aappp"], kept=["pp", "aappp"])
)
def test_d01_actions_reach_the_kart_of_their_agent(kinds):
    players = [f"kart_{i}" for i, kind in enumerate(kinds) if kind == "p"]
    with race_v0.parallel_env(agents=specs(kinds), num_kart=5, track=SHORT_TRACK) as env:
        for seed in range(4):
            env.reset(seed=seed)
            start = env.snapshot.karts["location"].copy()
            driver = players[seed % len(players)]
            for _ in range(UNTIL_MOVING):
                env.step(idle(env) | {driver: kart_action(throttle=1.0)})
            driven = np.linalg.norm(env.snapshot.karts["location"] - start, axis=1)
            by_agent = dict(
                zip(env.possible_agents, driven[list(env.race.kart_indices)], strict=True)
            )
            assert max(players, key=by_agent.get) == driver
            assert by_agent[driver] > 10


def test_d01_actions_reach_the_right_kart_when_agents_have_different_views():
    view = {"kart_0": "flattened_discrete", "kart_2": "flattened_continuous_actions"}
    with race_v0.parallel_env(num_kart=3, track=SHORT_TRACK, view=view) as env:
        for seed in range(3):
            env.reset(seed=seed)
            start = env.snapshot.karts["location"].copy()
            still = np.array([0.0, 0.0], np.float32)
            for _ in range(UNTIL_MOVING):
                straight = 3 * 5 * 2**5  # the middle of 7 steering angles
                env.step({"kart_0": straight, "kart_1": kart_action(1.0), "kart_2": still})
            driven = np.linalg.norm(env.snapshot.karts["location"] - start, axis=1)
            assert np.argmax(driven) == env.race.kart_indices[1]


# ----------------------------------------------------------------------------- D02 and D03


@pytest.mark.parametrize("places", [(0, 1, 2), (2, 0, 1), (3, None, 0), (None, None, 1)])
def test_d02_agents_get_the_start_positions_they_request(places):
    agents = [AgentSpec(rank_start=place) for place in places]
    with race_v0.parallel_env(agents=agents, num_kart=4, track=SHORT_TRACK) as env:
        for seed in range(3):
            env.reset(seed=seed)
            taken = env.race.kart_indices
            assert all(place in (None, kart) for place, kart in zip(places, taken, strict=True))
            assert len(set(taken)) == len(taken)


# ---------------------------------------------------------------------------- D05 and D06


def test_d05_a_finished_agent_gets_the_bonus_once(finished_race):
    steps, _ = finished_race
    for agent in "012":
        rewards = [info["reward"][agent] for *_, info in steps]
        finish = [info["terminated"][agent] for *_, info in steps].index(True)
        assert rewards[finish] >= 9.9
        assert not any(rewards[finish + 1 :])


def test_d06_each_agent_has_its_own_reward_termination_and_info(finished_race):
    steps, _ = finished_race
    for _, reward, terminated, _, info in steps:
        assert reward == pytest.approx(sum(info["reward"].values()))
        assert set(info["reward"]) == set(info["done"]) == set(info["infos"]) == set("012")
        assert terminated == all(info["done"].values())


@st.composite
def race_histories(draw):
    """Draws distances ``(T, K)`` and each kart's finishing step, or ``None``."""
    num_kart = draw(st.integers(1, 6))
    num_steps = draw(st.integers(1, 12))
    finishing = st.one_of(st.none(), st.integers(0, num_steps - 1))
    finish_steps = draw(st.lists(finishing, min_size=num_kart, max_size=num_kart))
    meters = st.floats(-300, 150, allow_nan=False, width=32)
    row = st.lists(meters, min_size=num_kart, max_size=num_kart)
    distances = draw(st.lists(row, min_size=num_steps, max_size=num_steps))
    return np.array(distances, np.float32), finish_steps


def snapshots_of(distances, finish_steps, lap_length):
    """Yields the race's snapshots, ranked as by the game: finishers by time, others by distance."""
    num_kart = len(finish_steps)
    order = []
    for step in range(-1, len(distances)):
        row = np.full(num_kart, -lap_length) if step < 0 else distances[step]
        now = [k for k in range(num_kart) if finish_steps[k] == step and step >= 0]
        order += now
        others = sorted((k for k in range(num_kart) if k not in order), key=lambda k: -row[k])
        karts = np.zeros(num_kart, KART_DTYPE)
        karts["overall_distance"] = np.minimum(row, lap_length)
        karts["overall_distance"][order] = lap_length
        karts["has_finished_race"][order] = 1
        for rank, kart in enumerate([*order, *others], start=1):
            karts["position"][kart] = rank
        header = np.zeros(1, HEADER_DTYPE)
        header["num_kart"] = num_kart
        yield Snapshot.of(header[0], karts, np.zeros(0, ITEM_DTYPE))


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(race_histories())
def test_d06_a_better_finish_never_earns_less_under_the_placement_reward(history):
    distances, finish_steps = history
    lap_length = 100.0
    reward = as_reward("placement")
    before, *moments = snapshots_of(distances, finish_steps, lap_length)
    earned = np.zeros(len(finish_steps))
    for after in moments:
        values = sum(values_of(reward, Transition(before, after, lap_length)).values())
        earned += np.where(before.karts["has_finished_race"], 0.0, values)
        before = after
    by_rank = [earned[kart] for kart in np.argsort(after.karts["position"])]
    assert all(better >= worse - 1e-9 for better, worse in pairwise(by_rank))


# ------------------------------------------------------------------------------------ D07


@pytest.mark.parametrize("values", [2, 5, 7, 10])
def test_d07_every_step_survives_the_round_trip(values):
    steps = Discretizer(gym.spaces.Box(-1, 1, (1,)), values)
    back = [steps.discretize(np.float32(steps.continuous(k))) for k in range(values)]
    assert back == list(range(values))


def test_d07_actions_of_the_games_ai_become_the_nearest_steps():
    env = gym.make(
        "supertuxkart/flattened_multidiscrete-v0", agent=AgentSpec(use_ai=True), track=SHORT_TRACK
    )
    env.reset(seed=3)
    core = env.unwrapped.core
    errors = []
    for _ in range(150):
        observation, *_ = env.step(env.action_space.sample())
        steer = core.snapshot.karts["control"][core.race.kart_indices[0], 1]
        errors.append(observation["action"][-1] / 3 - 1 - steer)
    env.close()
    assert np.abs(errors).max() <= 1 / 6 + 1e-6
    assert len(set(np.round(errors, 3))) > 5


# ------------------------------------------------------------------------------------ D08


@pytest.mark.slow
def test_d08_flattened_views_have_exactly_two_keys():
    for view in (view for view in stkzoo.views.VIEWS if view.startswith("flattened")):
        env = gym.make(f"supertuxkart/{view}-v0", track=SHORT_TRACK)
        observation, _ = env.reset(seed=0)
        env.close()
        assert set(env.observation_space) == set(observation) == {"continuous", "discrete"}


# ------------------------------------------------------------------------------------ D09


def test_d09_observations_of_mixed_agents_are_in_their_spaces():
    env = gym.make(MULTI_ID, agents=specs("ap"), track=SHORT_TRACK)
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert "action" in observation["0"]
    assert "action" not in observation["1"]
    env.close()


# ------------------------------------------------------------------------------------ D12


@pytest.mark.parametrize(
    ("options", "read", "expected"),
    [
        ({"laps": 2}, lambda env: env.race.laps, 2),
        ({"difficulty": 0}, lambda env: env.race.difficulty, 0),
        ({"reverse": True}, lambda env: env.race.reverse, True),
        ({"track": ["zengarden"]}, lambda env: env.race.track, "zengarden"),
        ({"max_paths": 4}, lambda env: len(env.observe(["kart_0"])["kart_0"]["paths_width"]), 4),
    ],
)
def test_d12_options_given_at_reset_take_effect(options, read, expected):
    with race_v0.parallel_env(num_kart=2, track=SHORT_TRACK) as env:
        env.reset(seed=0, options=options)
        assert read(env) == expected


def test_d12_an_episode_can_be_shortened_at_reset():
    with race_v0.parallel_env(num_kart=2, track=SHORT_TRACK) as env:
        env.reset(seed=0, options={"max_cycles": 2})
        env.step(idle(env))
        *_, truncations, _ = env.step(idle(env))
        assert truncations == {"kart_0": True, "kart_1": True}
        assert env.agents == []


def test_d12_the_dict_of_agents_needs_no_arguments():
    env = stkzoo.STKRaceMultiEnv(track=SHORT_TRACK)
    assert list(env.reset(seed=0)[0]) == ["0", "1", "2"]
    env.close()


# ------------------------------------------------------------------------------------ D14


class TenfoldReward(gym.RewardWrapper):
    """Multiplies the reward by ten."""

    def reward(self, reward):
        return 10 * reward


def parallel_race():
    return race_v0.parallel_env(num_kart=2, track=SHORT_TRACK, reward="reference")


def dict_race():
    return gym.make(MULTI_ID, num_kart=2, track=SHORT_TRACK)


@pytest.mark.parametrize("make", [parallel_race, dict_race])
def test_d14_stateful_wrappers_reset_with_the_race(make):
    env = MonoAgentWrapperAdapter(make(), wrapper_factories={"0": Counter})
    agents = list(env.reset(seed=0)[0])
    for _ in range(3):
        observations, *_ = env.step({agent: kart_action() for agent in agents})
    assert observations[agents[0]] == 4
    assert env.reset(seed=0)[0][agents[0]] == 1
    env.close()


@pytest.mark.parametrize("make", [parallel_race, dict_race])
def test_d14_reward_wrappers_change_their_agents_reward(make):
    def rewards(env):
        agents = list(env.reset(seed=0)[0])
        _, reward, _, _, info = env.step({agent: kart_action() for agent in agents})
        env.close()
        return list(info.get("reward", reward).values())

    plain = rewards(make())
    wrapped = rewards(MonoAgentWrapperAdapter(make(), wrapper_factories={"1": TenfoldReward}))
    assert wrapped == pytest.approx([plain[0], 10 * plain[1]])
    assert plain[1] != 0


# ------------------------------------------------------------------------------------ D15


@pytest.mark.parametrize("kart", ["sara_the_racer", "sara_the_wizard", "gnu"])
def test_d15_every_kart_name_is_in_the_space(kart):
    env = gym.make("supertuxkart/full-v0", agent=AgentSpec(kart=kart), track=SHORT_TRACK)
    observation, _ = env.reset(seed=0)
    env.close()
    assert observation["kart_type"] == kart
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(("held", "seen"), [(6, 6), (9, 9), (12, 9)])
def test_d15_many_power_ups_are_in_the_space(held, seen):
    with race_v0.parallel_env(num_kart=1, track=SHORT_TRACK) as env:
        env.reset(seed=0)
        karts = env.snapshot.karts.copy()
        karts["powerup_num"] = held
        snapshot = Snapshot.of(env.snapshot.header, karts, env.snapshot.items)
        moment = moment_of(snapshot, env.track_map, env.race.kart_types)
        count = observe_full(moment, [0])[0]["powerup_count"]
    assert count == seen
    assert kart_observation_space()["powerup_count"].contains(count)


@pytest.mark.slow
@pytest.mark.parametrize("use_ai", [False, True])
@pytest.mark.parametrize("env_id", EACH_ID)
def test_d15_a_lone_kart_can_race(env_id, use_ai):
    env = gym.make(env_id, num_kart=1, agent=AgentSpec(use_ai=use_ai), track=SHORT_TRACK)
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        assert env.observation_space.contains(observation)
        observation, *_ = env.step(env.action_space.sample())
    env.close()


# ------------------------------------------------------------------------------------ D16


def driving_distances(track):
    """Returns distances ``(N, N)`` between the starts of segments by Floyd and Warshall [m]."""
    count = len(track.successors)
    meters = np.full((count, count), np.inf)
    np.fill_diagonal(meters, 0)
    begin = track.path_distance[:, 0].astype(float)
    for node, successors in enumerate(track.successors):
        for following in successors:
            meters[node, following] = (begin[following] - begin[node]) % track.length
    for middle in range(count):
        np.minimum(meters, meters[:, middle, None] + meters[middle], out=meters)
    return meters


@pytest.mark.parametrize(
    "name", marked(["cocoa_temple", "stk_enterprise", "hacienda", "lighthouse"], ["cocoa_temple"])
)
def test_d16_segments_are_sorted_by_driving_distance(name):
    with race_v0.parallel_env(num_kart=1, track=name) as env:
        env.reset(seed=0)
        track = env.track_map
    nodes = np.arange(track.num_nodes)
    order = track.nodes_ahead(nodes)
    ahead = np.take_along_axis(driving_distances(track), order, axis=1)
    reachable = np.where(np.isinf(ahead), np.nanmax(ahead[np.isfinite(ahead)]), ahead)
    assert (order[:, 0] == nodes).all()
    assert (np.sort(order, axis=1) == nodes).all()
    assert np.diff(reachable, axis=1).min() > -1e-2


def test_d16_changing_an_observation_does_not_affect_later_ones():
    env = gym.make("supertuxkart/full-v0", track=SHORT_TRACK)
    observation, _ = env.reset(seed=0)
    kept = [row.copy() for row in observation["paths_distance"]]
    for row in observation["paths_distance"]:
        row /= 1000
    again, _ = env.reset(seed=0)
    env.close()
    assert same(tuple(kept), again["paths_distance"])


@pytest.mark.parametrize("name", ["path_nodes", "path_width", "path_distance"])
def test_d16_the_track_is_read_only(name):
    env = gym.make("supertuxkart/full-v0", track=SHORT_TRACK)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="read-only"):
        getattr(env.unwrapped.track, name)[0] = 0
    env.close()


def seen_line(start, end):
    """Returns how a kart at the origin, heading along z, observes a straight center line."""
    ends = np.array([[start, end]], np.float32)
    track = TrackMap(
        length=100.0,
        path_nodes=ends,
        path_width=np.ones((1, 1), np.float32),
        path_distance=np.array([[0, 100]], np.float32),
        successors=[[0]],
    )
    karts = np.zeros(1, KART_DTYPE)
    karts["rotation"][:, 0] = 1
    header = np.zeros(1, HEADER_DTYPE)
    snapshot = Snapshot.of(header[0], karts, np.zeros(0, ITEM_DTYPE))
    (seen,) = observe_full(moment_of(snapshot, track, ["tux"]), [0])
    return seen["center_path"].tolist(), seen["center_path_distance"][0]


@pytest.mark.parametrize(
    ("start", "end", "vector", "distance"),
    [
        ((3, 0, -5), (3, 0, 5), [-3, 0, 0], -3),
        ((-3, 0, -5), (-3, 0, 5), [3, 0, 0], 3),
        ((-5, 0, 9), (5, 0, 9), [0, 0, -9], 9),
    ],
    ids=["right", "left", "straight ahead"],
)
def test_the_center_line_is_observed_at_its_place(start, end, vector, distance):
    assert seen_line(start, end) == (vector, distance)


# ------------------------------------------------------------------------------------ D17


@pytest.mark.slow
def test_d17_no_compiler_is_loaded_for_a_race():
    code = (
        "import sys, gymnasium, stkzoo\n"
        "env = gymnasium.make('supertuxkart/simple-v0', track='lighthouse')\n"
        "env.reset(seed=0); env.step(env.action_space.sample()); env.close()\n"
        "print([name for name in ('numba', 'llvmlite', 'torch', 'pystk2') if name in sys.modules])"
    )
    assert run_python(code) == "[]"


def run_python(code):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.stdout.strip()


# ------------------------------------------------------------------------------------ D18


def test_d18_seeding_one_space_does_not_affect_the_others():
    env = gym.make(MULTI_ID, num_kart=2)
    other = gym.make(MULTI_ID, num_kart=2)
    for space in (env.action_space["1"], other.action_space["0"]):
        space.seed(5)
    expected = [space.sample() for space in (env.action_space["1"], other.action_space["0"])]
    for space in (env.action_space["1"], other.action_space["0"]):
        space.seed(5)
    env.action_space["0"].seed(9)
    drawn = [space.sample() for space in (env.action_space["1"], other.action_space["0"])]
    assert same(dict(enumerate(drawn)), dict(enumerate(expected)))


@pytest.mark.parametrize("env_id", EACH_ID)
def test_d18_no_space_is_shared_between_environments(env_id):
    one, two = gym.make(env_id), gym.make(env_id)
    assert one.observation_space == two.observation_space
    assert one.observation_space is not two.observation_space
    if isinstance(one.observation_space, gym.spaces.Dict):
        one.observation_space.spaces["mine"] = gym.spaces.Discrete(2)
        assert "mine" not in two.observation_space.spaces
        assert "mine" not in gym.make(env_id).observation_space.spaces


# ------------------------------------------------------------------------- invalid arguments

BAD_ARGUMENTS = [
    ({"track": {"lighthouse": 1}}, "track is"),
    ({"num_kart": 10**6}, "num_kart is 1000000"),
    ({"difficulty": 9}, "difficulty is 9, expected a whole number from 0 to 3"),
    ({"step_size": 0}, "step_size is 0"),
    ({"step_size": float("nan")}, "step_size is nan"),
    ({"max_cycles": 10.5}, "max_cycles is 10.5"),
    ({"max_paths": "all"}, "max_paths is 'all'"),
    ({"graphics_config": "ultra"}, "unknown graphics_config 'ultra'"),
    ({"engine_timeout": float("nan")}, "engine_timeout is nan"),
    ({"view": {"kart_9": "full"}}, "kart_9"),
    ({"reward": "placment"}, "Did you mean 'placement'"),
    ({"reward": {"drift": 1.0}}, "unknown reward term 'drift'"),
    ({"reward": {"time": float("nan")}}, "'time' is nan"),
    ({"agents": 0}, "0 agents for 3 karts"),
    ({"agents": [AgentSpec()] * 4}, "4 agents for 3 karts"),
    ({"agents": [AgentSpec(rank_start=3)]}, "rank_start of agent 0 is 3"),
    ({"agents": [AgentSpec(rank_start=1), AgentSpec(rank_start=1)]}, "rank_start=1"),
    ({"agents": [AgentSpec(kart="gnuu")]}, "Did you mean 'gnu'"),
    ({"agents": [AgentSpec(color=float("nan"))]}, "color of agent 0 is nan"),
    ({"agents": [AgentSpec(camera_mode="BEHIND")]}, "camera_mode is 'BEHIND'"),
    ({"end_when_stuck": 0}, "end_when_stuck is 0, expected"),
    ({"end_off_road": float("nan")}, "end_off_road is nan, expected"),
    ({"end_when_first_finishes": 1.5}, "end_when_first_finishes is 1.5, expected"),
    ({"events": 1}, "events is 1, expected"),
]


@pytest.mark.parametrize(
    ("arguments", "message"), BAD_ARGUMENTS, ids=lambda value: repr(value)[:60]
)
def test_an_invalid_argument_is_refused(arguments, message):
    with pytest.raises(ConfigError, match=message):
        race_v0.parallel_env(**arguments)


BAD_OPTIONS = [
    ({"track": "nowhere"}, "unknown track 'nowhere'"),
    ({"track": []}, "empty list"),
    ({"laps": 0}, "laps is 0"),
    ({"difficulty": 9}, "difficulty is 9"),
    ({"step_size": float("nan")}, "step_size is nan"),
    ({"max_cycles": 0}, "max_cycles is 0"),
    ({"max_paths": -1}, "max_paths is -1"),
    ({"reverse": 1}, "reverse is 1"),
]


@pytest.fixture(scope="module")
def running_race():
    with race_v0.parallel_env(num_kart=2, track=SHORT_TRACK) as env:
        env.reset(seed=0)
        yield env


@pytest.mark.parametrize(("options", "message"), BAD_OPTIONS, ids=repr)
def test_invalid_options_are_refused_and_the_race_continues(running_race, options, message):
    ticks = running_race.snapshot.header["aux_ticks"]
    with pytest.raises(ConfigError, match=message):
        running_race.reset(options=options)
    running_race.step(idle(running_race))
    assert running_race.snapshot.header["aux_ticks"] > ticks


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True])
def test_an_invalid_seed_is_refused(running_race, seed):
    with pytest.raises(ConfigError, match=f"seed is {seed!r}"):
        running_race.reset(seed=seed)


def test_integers_of_numpy_are_accepted():
    with race_v0.parallel_env(
        num_kart=np.int64(2), laps=np.int32(1), agents=np.int64(1), track=SHORT_TRACK
    ) as env:
        assert list(env.reset(seed=np.int64(3))[0]) == ["kart_0"]


def test_d28_x_points_to_the_right():
    with race_v0.parallel_env(num_kart=1, track=SHORT_TRACK, view="full") as env:
        env.reset(seed=1)
        for _ in range(UNTIL_MOVING):
            before = env.step({"kart_0": kart_action(1.0)})[0]["kart_0"]
        for _ in range(8):
            after = env.step({"kart_0": kart_action(1.0, 1.0)})[0]["kart_0"]
        ahead = max(range(5), key=lambda number: before["paths_end"][number][2])
        gone = before["paths_distance"][ahead], [row[0] for row in after["paths_distance"]]
        same_node = gone[1].index(gone[0][0])
        # After a right turn, what was ahead is on the left.
        assert after["paths_end"][same_node][0] < before["paths_end"][ahead][0] - 1.0


def test_every_test_that_the_page_of_differences_names_exists():
    page = (ROOT / "docs" / "reference" / "differences.md").read_text()
    code = "".join(file.read_text() for file in (ROOT / "tests").rglob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", page))
    assert len(named) > 40
    assert {name for name in named if f"def {name}(" not in code} == set()
