"""The racing line: inside the free ground, shorter than the driving line, and observed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from stkzoo import race_v0
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.names import GroundKind
from stkzoo.wrappers.racing import racing_line
from stkzoo.wrappers.racing.racing_line import _least_squares
from tests.engine.test_ground import FLOOR, ground_with, wall
from tests.wrappers.test_ground import straight_track


def length_of(nodes):
    return float(np.linalg.norm(nodes[:, 1] - nodes[:, 0], axis=1).sum())


def test_on_a_straight_road_the_line_is_its_middle():
    track = straight_track()
    line = racing_line(track, ground_with(FLOOR))
    np.testing.assert_allclose(line.nodes, track.path_nodes, atol=0.01)
    # 5 m of road and 1.5 m beyond; the ground ends with the last segment
    np.testing.assert_allclose(line.rooms[:-1], 6.5, atol=0.26)


def test_the_line_does_not_count_ground_behind_a_wall():
    line = racing_line(straight_track(), ground_with(FLOOR, wall(5.4, (0, 40), (0, 2))))
    left, right = line.rooms[:-1].T
    assert (right < 5.5).all()
    assert (left > 6.2).all()


@pytest.mark.slow
@pytest.mark.parametrize("track", ["hacienda", "minigolf"])
def test_the_line_is_shorter_than_the_driving_line_and_on_free_ground(track):
    with race_v0.parallel_env(num_kart=1, track=track) as env:
        env.reset(seed=1)
        course, ground = env.track_map, env.ground
    line = racing_line(course, ground)
    assert length_of(line.nodes) < 0.98 * length_of(course.path_nodes)
    middles = line.nodes.mean(axis=1)
    kinds = ground.at(middles + np.array([0, 0.5, 0]), reach=3.0).kind
    assert np.isin(kinds, (GroundKind.VOID, GroundKind.WALL)).mean() < 0.03
    assert (line.rooms >= 1).all()


def test_the_ground_view_shows_the_line():
    with race_v0.parallel_env(num_kart=2, track="hacienda", view="ground") as env:
        observations, _ = env.reset(seed=3)
        for _ in range(40):
            observations, *_ = env.step({a: env.action_space(a).sample() for a in env.agents})
        line = racing_line(env.track_map, env.ground)
        for agent, kart in zip(env.agents, env.race.kart_indices, strict=True):
            seen = observations[agent]
            assert env.observation_space(agent).contains(seen)
            steps = np.linalg.norm(np.diff(seen["ground_line"], axis=0), axis=1)
            assert (steps[:20] < 3.01).all()
            assert (steps[:20] > 2.5).all()
            record = env.snapshot.karts[[kart]]
            matrix = rotation_matrices(record["rotation"])
            nodes = to_kart_frame(line.nodes.reshape(1, -1, 3), record["location"], matrix)
            start, end = nodes.reshape(-1, 2, 3)[int(record["node"][0])]
            along = (end - start) / np.linalg.norm(end - start)
            beside = seen["ground_line"][0] - start  # on the kart's own segment
            assert np.linalg.norm(beside - (beside @ along) * along) < 0.3
            assert (seen["ground_room"] >= 1).all()


@pytest.mark.slow
@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_the_solver_finds_the_least_squares_solution_with_bounds(seed):
    chance = np.random.default_rng(seed)
    size = int(chance.integers(2, 12))
    matrix = np.concatenate([0.3 * np.eye(size), chance.normal(size=(size, size)) / size])
    wanted, middle = chance.normal(size=2 * size), chance.normal(size=size)
    low, high = middle - chance.random(size), middle + chance.random(size)
    found = _least_squares(matrix, wanted, low, high)
    best = lsq_linear(matrix, wanted, (low, high), tol=1e-12).x
    np.testing.assert_allclose(found, best, atol=0.02)
