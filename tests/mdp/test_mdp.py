"""Observations, rewards and the order of track segments, on made-up and real snapshots."""

import numpy as np
import pytest
from gymnasium import spaces

from stkzoo import race_v0
from stkzoo.config import AgentSpec
from stkzoo.engine.snapshot import HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.engine.track import TrackMap, decode_track, encode_track
from stkzoo.errors import ConfigError
from stkzoo.mdp.rewards import REWARDS, Reward, RewardOver, advance
from stkzoo.mdp.spaces import EXTRAS, kart_observation_space
from stkzoo.mdp.state import KART_FEATURES, state_space
from stkzoo.mdp.transition import Transition
from tests.support.generic_env import moment_of, observe_full
from tests.support.rewards import values_of


def make_snapshot(num_kart=2, num_items=0, **fields):
    header = np.zeros(1, HEADER_DTYPE)
    header["num_kart"], header["num_items"] = num_kart, num_items
    karts = np.zeros(num_kart, KART_DTYPE)
    karts["rotation"][:, 0] = 1
    karts["position"] = np.arange(1, num_kart + 1)
    for name, value in fields.items():
        karts[name] = value
    return Snapshot.of(header[0], karts, np.zeros(num_items, ITEM_DTYPE))


def forked_track():
    """Returns a track where node 0 forks into 1 and into 2, 3; both join in 4, before 0."""
    begin = np.array([0, 10, 10, 15, 30], np.float32)
    return decode_track(
        encode_track(
            TrackMap(
                40.0,
                np.zeros((5, 2, 3), np.float32),
                np.ones((5, 1), np.float32),
                np.stack([begin, begin + 5], axis=1),
                [[1, 2], [4], [3], [4], [0]],
            )
        )
    )


def test_nodes_ahead_are_sorted_by_driving_distance():
    ahead = forked_track().nodes_ahead(np.array([0, 1]))
    assert ahead.tolist() == [[0, 1, 2, 3, 4], [1, 4, 0, 2, 3]]


def test_a_branch_that_was_not_taken_is_a_lap_away():
    assert forked_track().nodes_ahead(np.array([2])).tolist() == [[2, 3, 4, 0, 1]]


def test_nodes_ahead_stop_at_max_paths():
    assert forked_track().nodes_ahead(np.array([4]), 2).tolist() == [[4, 0]]


def test_unreachable_nodes_are_last():
    track = TrackMap(
        length=20,
        path_nodes=np.zeros((3, 2, 3), np.float32),
        path_width=np.ones((3, 1), np.float32),
        path_distance=np.array([[0, 5], [5, 9], [10, 15]], np.float32),
        successors=[[2], [2], [0]],
    )
    assert track.nodes_ahead(np.array([0])).tolist() == [[0, 2, 1]]


def test_karts_in_front_come_first_then_those_behind():
    snapshot = make_snapshot(5, location=[[0, 0, z] for z in (0, -2, 7, -9, 3)])
    (seen,) = observe_full(moment_of(snapshot, forked_track(), ["tux"] * 5), [0])
    assert [place[2] for place in seen["karts_position"]] == [3, 7, -2, -9]


def transition(before, after, race_length=100.0):
    return Transition(
        make_snapshot(len(before["position"]), **before),
        make_snapshot(len(after["position"]), **after),
        race_length,
    )


def test_the_reference_reward_follows_the_documented_formula():
    before = {"position": [1, 2], "overall_distance": [50.0, -100.0], "has_finished_race": [0, 0]}
    after = {"position": [1, 2], "overall_distance": [60.0, 2.0], "has_finished_race": [1, 0]}
    terms = values_of(REWARDS["reference"], transition(before, after))
    totals = sum(terms.values())
    assert np.allclose(totals, [10 / 10 + 0.5 * 10 - 0.1 + 10, 2 / 10 + 0 - 0.1])


def test_the_jump_at_the_start_line_is_not_progress():
    before = {"position": [1], "overall_distance": [-880.0]}
    after = {"position": [1], "overall_distance": [3.0]}
    assert values_of(REWARDS["reference"], transition(before, after))["progress"].tolist() == [0.3]


def test_a_finish_is_rewarded_in_one_step_only():
    moment = {"position": [1], "overall_distance": [100.0], "has_finished_race": [1]}
    terms = values_of(REWARDS["reference"], transition(moment, moment))
    assert terms["finish"].tolist() == [0]


def test_terms_can_be_reweighted_dropped_and_added():
    reward = {"time": 2.0, "rank": 0, "bonus": lambda step: np.ones(step.num_kart)}
    with race_v0.parallel_env(
        num_kart=1, track="lighthouse", reward=RewardOver("reference", reward)
    ) as env:
        env.reset(seed=1)
        info = env.step({"kart_0": env.action_space("kart_0").sample()})[-1]["kart_0"]
    terms = {name.removeprefix("reward/"): info[name] for name in info if name[:7] == "reward/"}
    assert terms.keys() == {"progress", "rank", "time", "finish", "bonus"}
    assert [terms[name] for name in ("rank", "time", "finish", "bonus")] == [0.0, -0.2, 0.0, 1.0]


def test_a_term_with_a_limit_pays_a_jump_in_parts():
    """The rest is part of a saved state."""
    earned = iter([0.0, 10.0, 0.0])
    jumps = Reward({"jump": lambda _: np.full(2, next(earned))}, {"jump": 2.0}, {"jump": 40.0})
    with race_v0.parallel_env(num_kart=2, track="lighthouse", reward=jumps) as env:
        env.reset(seed=1)
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        paid = [env.step(actions)[1]["kart_0"] for _ in range(2)]
        state = env.save_state()
        env.step(actions)
        env.restore_state(state)
        earned = iter([0.0, -12.0, 0.0, 0.0])
        paid += [env.step(actions)[1]["kart_0"] for _ in range(4)]
    assert paid == pytest.approx([0.0, 8.0, 0.8, -7.2, -0.8, -0.8])


def test_the_finishing_step_pays_all_that_is_left():
    agents = [AgentSpec(use_ai=True)]
    slow = Reward({"advance": advance}, limits={"advance": 0.01})
    with race_v0.parallel_env(agents=agents, num_kart=1, track="lighthouse", reward=slow) as env:
        env.reset(seed=1)
        while env.agents:
            _, rewards, terminations, _, infos = env.step({})
            assert rewards["kart_0"] <= 0.0011 or terminations["kart_0"]
        assert infos["kart_0"]["episode/return"] == pytest.approx(env.track_map.length / 10)


@pytest.mark.parametrize("limit", ["much", 0, float("inf")])
def test_a_limit_that_is_no_positive_number_is_refused(limit):
    with pytest.raises(ConfigError, match=r"limit of reward term 'mine' is .* a"):
        Reward({"mine": lambda step: np.ones(step.num_kart)}, limits={"mine": limit})


@pytest.mark.parametrize("weight", ["much", None, float("inf")])
def test_a_weight_that_is_no_finite_number_is_refused(weight):
    with pytest.raises(ConfigError, match=r"reward term 'mine' is .* a finite number"):
        Reward({"mine": lambda step: np.ones(step.num_kart)}, {"mine": weight})


def test_each_agent_can_have_its_own_reward():
    with race_v0.parallel_env(
        num_kart=2,
        track="olivermath",
        reward={"kart_0": "placement", 1: {"time": 3.0}},
    ) as env:
        _, infos = env.reset(seed=1)
        assert set(infos["kart_0"]) == set(infos["kart_1"])
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        _, rewards, _, _, infos = env.step(actions)
        assert infos["kart_0"]["reward/time"] == 0
        assert infos["kart_1"]["reward/time"] == pytest.approx(-0.3)
        for agent, info in infos.items():
            terms = [value for name, value in info.items() if name.startswith("reward/")]
            assert rewards[agent] == pytest.approx(sum(terms))


@pytest.mark.slow
def test_episode_sums_add_up_over_a_whole_race():
    agents = [AgentSpec(use_ai=True), AgentSpec(use_ai=True)]
    with race_v0.parallel_env(agents=agents, num_kart=2, track="olivermath") as env:
        env.reset(seed=3)
        returns = dict.fromkeys(env.possible_agents, 0.0)
        last = {}
        while env.agents:
            _, rewards, _, _, infos = env.step({})
            for agent, reward in rewards.items():
                returns[agent] += reward
                last[agent] = infos[agent]
        for agent in env.possible_agents:
            assert last[agent]["episode/return"] == pytest.approx(returns[agent])
            assert last[agent]["finish_time"] > 10


def test_bounds_of_spaces_are_plain_numbers(monkeypatch):
    bounds = []

    def record(low, high, *arguments, **options):
        bounds.extend((low, high))
        return box(low, high, *arguments, **options)

    box = spaces.Box
    monkeypatch.setattr(spaces, "Box", record)
    kart_observation_space(use_ai=True, extras=EXTRAS)
    # Gymnasium before 1.2.4 refuses members of enumerations.
    assert {type(bound) for bound in bounds} <= {int, float}


def test_the_state_fits_its_space_and_starts_with_the_agents():
    with race_v0.parallel_env(agents=1, num_kart=3, track="olivermath") as env:
        env.reset(seed=1)
        state = env.state()
        assert env.state_space == state_space(3)
        assert env.state_space.contains(state)
        kart = env.race.kart_indices[0]
        assert state[4:7].tolist() == env.snapshot.karts["location"][kart].tolist()
        assert len(state) == 4 + 3 * sum(size for _, size in KART_FEATURES)
