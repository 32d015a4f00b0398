"""The racing view has the same values for one kart, a batch and a whole race."""

import itertools

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers.utils import create_zero_array

from stkzoo import AgentSpec, race_v0
from stkzoo.errors import AgentError, ConfigError
from stkzoo.mdp.geometry import rotation_matrices
from stkzoo.names import ItemType
from stkzoo.race import run_race
from stkzoo.views import VIEWS
from stkzoo.wrappers import PolarObservations
from stkzoo.wrappers.racing import (
    CHOICES,
    MIRROR,
    PARTS,
    SIZE,
    STEERS,
    RacingActions,
    RacingObservations,
    choices_of_action,
    controls_of_choices,
    racing_features,
    road_observer,
    surroundings_of,
)
from stkzoo.wrappers.racing.features import MARKS
from stkzoo.wrappers.racing.surroundings import traced
from tests.support.generic_env import kart_env


class OneKart(gym.Env):
    """A single-agent environment that only has the spaces of kart_0."""

    def __init__(self, env):
        self.observation_space = env.observation_space("kart_0")
        self.action_space = env.action_space("kart_0")


def part(view, name):
    """Returns one part of a view, ``(..., count, width)``."""
    begin = 0
    for other, (count, width) in PARTS.items():
        if other == name:
            rows = view[..., begin : begin + count * width]
            return rows.reshape(*view.shape[:-1], count, width)
        begin += count * width
    raise KeyError(name)


def places_of(env):
    return np.array([env.race.kart_indices[int(agent[5:])] for agent in env.agents])


def race(**options):
    return race_v0.parallel_env(
        **{"num_kart": 4, "track": "lighthouse", "max_cycles": 120} | options
    )


def moments(env, seed=3, steps=100):
    """Yields the full observations of a race with random actions."""
    chance = np.random.default_rng(seed)
    observations, _ = env.reset(seed=seed)
    for _ in range(steps):
        yield observations
        choices = np.stack([chance.integers(0, count, len(env.agents)) for count in CHOICES], 1)
        choices[:, 1] = 0
        actions = dict(zip(env.agents, choices, strict=True))
        chain = RacingActions(OneKart(env))
        observations, *_ = env.step({a: chain.action(c) for a, c in actions.items()})
        if not env.agents:
            return


@pytest.mark.parametrize(("track", "reverse"), [("lighthouse", False), ("candela_city", True)])
def test_one_kart_a_race_and_a_batch_have_the_same_observations(track, reverse):
    env = race(track=track, reverse=reverse)
    with env:
        view = RacingObservations(OneKart(env))
        for observations in itertools.islice(moments(env), 0, None, 9):
            alone = np.stack([view.observation(observations[agent]) for agent in env.agents])
            seen = [observations[agent] for agent in env.agents]
            together = racing_features(surroundings_of(seen))
            from_above = np.empty((len(env.agents), SIZE), np.float32)
            rows, observer = np.arange(len(env.agents)), road_observer(env.track_map)
            observer.observe_into(env.snapshot, places_of(env), rows, from_above)
            np.testing.assert_allclose(together, alone, atol=1e-5)
            np.testing.assert_allclose(from_above, alone, atol=1e-4)
    assert alone.shape == (4, SIZE)


def mirrored(observation):
    """Mirrors a full observation, so that x points to the left."""
    flipped = {}
    for key, value in observation.items():
        if isinstance(value, tuple) and key.endswith(("_position", "_start", "_end")):
            flipped[key] = tuple(row * np.array([-1, 1, 1], np.float32) for row in value)
        elif key in ("velocity", "front", "center_path"):
            flipped[key] = value * np.array([-1, 1, 1], np.float32)
        else:
            flipped[key] = value
    return flipped


def test_the_contest_view_adds_the_standing_to_the_racing_view():
    specs = [AgentSpec(team=0), AgentSpec(team=1), AgentSpec(team=0)]
    options = {"num_kart": 4, "agents": specs, "track": "lighthouse", "view": "contest"}
    with race_v0.parallel_env(**options) as env:
        env.reset(seed=1)
        for _ in range(80):
            action = np.array([12, 0, 1, 0, 0])
            observations = env.step(dict.fromkeys(env.agents, action))[0]
        karts, mine = env.snapshot.karts, env.race.kart_indices
        length = env.track_map.length
        teams = dict(zip(mine, (0, 1, 0), strict=True))
        matrices = rotation_matrices(karts["rotation"])
    for number, agent in zip(mine, observations, strict=True):
        seen, kart = observations[agent], karts[number]
        rank, progress, steer, drift, *rivals = seen[SIZE:].tolist()
        assert rank == pytest.approx((kart["position"] - 1) / 3)
        assert progress == pytest.approx(kart["overall_distance"] / length)
        assert (steer, drift) == (pytest.approx(float(STEERS[12])), 1.0)
        rows = np.reshape(rivals, (4, 9))
        assert rows[:, 0].tolist() == [1, 1, 1, 0]
        assert not rows[3].any()
        distances = np.linalg.norm(karts["location"] - kart["location"], axis=1)
        nearest = np.argsort(distances)[1:]
        for row, other in zip(rows, nearest.tolist(), strict=False):
            if distances[other] < 100:  # farther, positions are clipped
                place = 20 * np.linalg.norm(row[1:4])
                assert place == pytest.approx(distances[other], abs=1e-3)
            velocity = matrices[number] @ (karts["velocity"][other] - kart["velocity"])
            assert 20 * row[4:7] == pytest.approx(velocity, abs=1e-3)
            lead = karts["overall_distance"][other] - kart["overall_distance"]
            assert 20 * row[7] == pytest.approx(np.clip(lead, -100, 100), abs=1e-3)
            assert row[8] == (other in teams and teams[other] == teams[number])


def test_an_agent_in_a_race_sees_its_teammates(tmp_path):
    agent = tmp_path / "agent.py"
    agent.write_text(
        "env_name = 'supertuxkart/contest-v0'\n"
        "def get_actor(module_dir, seen, acted):\n"
        "    def act(state, observation):\n"
        "        rivals = observation[-36:].reshape(4, 9)\n"
        "        assert rivals[:, 8].sum() == 1, rivals\n"
        "        return [10, 0, 0, 0, 0]\n"
        "    return act\n"
    )
    drivers = [str(agent), "ai", str(agent), "random"]
    race = {"track": "lighthouse", "seed": 5, "max_steps": 3, "error_handling": "raise"}
    run_race(drivers, **race, teams=True)
    with pytest.raises(AgentError, match="AssertionError"):
        run_race(drivers, **race)


def test_a_mirrored_race_has_mirrored_observations():
    with race() as env:
        view = RacingObservations(OneKart(env))
        for observations in itertools.islice(moments(env), 0, None, 20):
            for agent in env.agents:
                there = view.observation(mirrored(observations[agent]))
                np.testing.assert_allclose(
                    there, view.observation(observations[agent]) * MIRROR, atol=1e-5
                )
    assert (MIRROR == -1).sum() > 30


def places_on_road(track, points):
    """Returns each point's distance from the track's center line and its place on it [m]."""
    starts, ends = track.path_nodes[:, 0].astype(float), track.path_nodes[:, 1].astype(float)
    along = ends - starts
    squares = (along * along).sum(-1)
    share = ((points[:, None] - starts) * along).sum(-1) / squares
    feet = starts + np.clip(share, 0, 1)[..., None] * along
    distances = np.linalg.norm(points[:, None] - feet, axis=-1)
    best = distances.argmin(axis=1)
    rows = np.arange(len(points))
    begin, end = track.path_distance[best].T
    return distances[rows, best], begin + np.clip(share[rows, best], 0, 1) * (end - begin)


@pytest.mark.parametrize("track", ["abyss", "hacienda"])
def test_marks_are_on_the_center_line_at_their_distances(track):
    with race(num_kart=1, track=track) as env:
        view = RacingObservations(OneKart(env))
        for observations in itertools.islice(moments(env), 30, None, 15):
            kart = env.snapshot.karts[0]
            one = view.observation(observations["kart_0"])
            marks = part(one, "marks_direction") * MARKS[:, None]
            beside = part(one, "line_position") * 10
            turn = rotation_matrices(kart["rotation"])
            points = np.concatenate([beside, marks]) @ turn + kart["location"]
            off, place = places_on_road(env.track_map, points)
            assert off.max() < 0.5
            ahead = (place[1:] - place[0]) % env.track_map.length
            np.testing.assert_allclose(ahead, MARKS, atol=1.0, rtol=0.1)


def road_line(starts, ends, width):
    widths = np.full(len(starts), width, np.float32)
    lines, _ = traced(starts[None], ends[None], widths[None], np.array([len(starts)]))
    return lines[0]


def test_the_line_continues_after_a_short_gap_but_not_after_a_long_one():
    def side_of(gap):
        starts = np.array([[0, 0, 0], [3, 0, 10 + gap]], np.float32)
        ends = starts + np.array([0, 0, 10], np.float32)
        return road_line(starts, ends, 1.0)[-1, 0]

    assert side_of(12.0) == pytest.approx(3.0)
    assert side_of(30.0) == pytest.approx(0.0)


def test_at_a_fork_the_line_follows_the_connected_branch():
    main = [[0, 0, 0], [0, 0, 10], [0, 0, 20], [0, 0, 30]]
    branch = [[6, 0, 10], [6, 0, 20]]
    order = [main[0], main[1], branch[0], main[2], branch[1], main[3]]
    starts = np.array(order, np.float32)
    line = road_line(starts, starts + np.array([0, 0, 10], np.float32), 1.0)
    assert np.abs(line[:, 0]).max() == 0.0


def test_items_are_observed_in_the_right_places():
    with race(num_kart=1, track="lighthouse", max_cycles=300) as env:
        view = RacingObservations(OneKart(env))
        good_kinds = (ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL)
        num_goods = 0
        for observations in itertools.islice(moments(env, steps=150), 0, None, 10):
            full = observations["kart_0"]
            nearness, beside, kind = (
                part(view.observation(full), f"goods_{name}")[0]
                for name in ("nearness", "beside", "type")
            )
            for place, item in zip(full["items_position"], full["items_type"], strict=True):
                distance = np.linalg.norm(place)
                is_ahead = place[2] > 0.5 and abs(place[1]) < 6 and distance < 60
                if item in good_kinds and is_ahead:
                    num_goods += 1
                    assert nearness[0] == pytest.approx(1 / (1 + distance / 5), 1e-4)
                    assert beside[0] == pytest.approx(np.clip(place[0] / 5, -5, 5), abs=1e-4)
                    assert kind.argmax() == good_kinds.index(item)
                    break
            else:
                assert nearness[0] == 0
    assert num_goods > 3


def test_choices_map_to_the_games_actions_and_back():
    with race(num_kart=1) as env:
        wrapped = RacingActions(OneKart(env))
        base = env.action_space("kart_0")
        for steer, pedal, *buttons in itertools.product(
            (0, 3, 6, 12), *(range(n) for n in CHOICES[1:])
        ):
            choices = np.array([steer, pedal, *buttons])
            action = wrapped.action(choices)
            assert base.contains(action)
            assert action["steer"][0] == STEERS[steer]
            pedals = (action["acceleration"][0], action["brake"], action["rescue"])
            assert pedals == [(1, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, 1)][pedal]
            assert (choices_of_action(action) == choices).all()
    together = controls_of_choices(np.stack([choices, choices]))
    assert together.shape == (2, 7)


def test_actions_of_the_ai_are_observed_as_choices():
    spec = [AgentSpec(use_ai=True), AgentSpec()]
    with race_v0.parallel_env(agents=spec, num_kart=2, track="lighthouse", view="racing") as env:
        observations, _ = env.reset(seed=1)
        done = []
        for _ in range(60):
            assert env.observation_space("kart_0").contains(observations["kart_0"])
            done.append(observations["kart_0"]["action"])
            observations, *_ = env.step({"kart_1": np.zeros(5, int)})
    assert len({int(choices[0]) for choices in done}) > 1  # the AI steers


def test_other_views_are_refused():
    with pytest.raises(ConfigError, match="needs the full view"):
        race(view=lambda env: RacingObservations(VIEWS["simple"](env)))
    with pytest.raises(ConfigError, match="found PolarObservations inside it"):
        race(view=lambda env: RacingObservations(PolarObservations(env)))
    with pytest.raises(ConfigError, match="game's own actions"):
        race(view=lambda env: RacingActions(VIEWS["control"](env)))


def test_a_kart_without_visible_road_has_a_finite_view():
    env = RacingObservations(kart_env())
    assert np.isfinite(env.observation(create_zero_array(env.env.observation_space))).all()
