"""The karts nearby: told from where they were, against what the engine says."""

import numpy as np

from stkzoo import race_v0
from stkzoo.agents.planning.driver import ALL_LOOKS
from stkzoo.agents.planning.rivals import RIVALS, RivalTracker
from stkzoo.agents.planning.road import LINE_MARKS, RoadAhead
from stkzoo.wrappers.racing import LOOKS, BatchedRacingView, RoadTable

STRAIGHT = np.zeros((1, len(LINE_MARKS), 4), np.float32)
STRAIGHT[0, :, 2], STRAIGHT[0, :, 3] = LINE_MARKS, 5.0
STILL = np.zeros((1, 3), np.float32)


def karts(*places):
    return np.array([[[x, 0.0, z] for x, z in places]], np.float32)


def test_one_that_gains_and_one_that_crosses_are_told_apart():
    tracker, road = RivalTracker(1), RoadAhead.of(STRAIGHT)
    tracker.watch(karts((1.0, 6.0), (-2.0, 12.0)), STILL, road)
    tracker.look()
    seen = tracker.watch(karts((-1.9, 11.8), (1.3, 6.5)), STILL, road)
    assert seen.is_there.tolist() == [[True, True, False, False]]
    np.testing.assert_allclose(seen.along[0, :2], [6.5, 11.8], atol=1e-4)
    np.testing.assert_allclose(seen.across[0, :2], [1.3, -1.9], atol=1e-4)
    np.testing.assert_allclose(seen.gain[0, :2], [5.0, -2.0], atol=1e-3)
    np.testing.assert_allclose(seen.drift[0, :2], [3.0, 1.0], atol=1e-3)


def test_what_comes_out_of_nowhere_has_no_speed_yet():
    tracker, road = RivalTracker(1), RoadAhead.of(STRAIGHT)
    tracker.watch(karts((0.0, 20.0)), STILL, road)
    tracker.look()
    seen = tracker.watch(karts((0.0, 10.0), (np.inf, np.inf)), STILL, road)
    assert seen.is_there.sum() == 1
    assert seen.gain[0, 0] == 0
    assert seen.drift[0, 0] == 0


def test_the_own_turn_and_way_are_taken_off():
    tracker = RivalTracker(1)
    turn, way = 0.12, 2.0
    velocity = np.array([[0.0, 0.0, 20.0]], np.float32)
    tracker.watch(karts((1.0, 9.0)), velocity, RoadAhead.of(STRAIGHT))
    tracker.look()
    # the same road and a kart that stands, seen from an arc of 2 m to the right
    start = way * np.array([np.sin(turn / 2), np.cos(turn / 2)])
    x, z = np.array([1.0, 9.0]) - start
    line = STRAIGHT.copy()
    line[0, :, 0] = -start[0] * np.cos(turn) - np.sin(turn) * LINE_MARKS
    line[0, :, 2] = -start[0] * np.sin(turn) + np.cos(turn) * LINE_MARKS
    spot = x * np.cos(turn) - z * np.sin(turn), x * np.sin(turn) + z * np.cos(turn)
    seen = tracker.watch(karts(spot), velocity, RoadAhead.of(line))
    np.testing.assert_allclose(seen.gain[0, 0], -20.0, atol=0.01)
    np.testing.assert_allclose(seen.drift[0, 0], 0.0, atol=0.01)


def test_to_look_again_changes_nothing_and_to_forget_forgets():
    tracker, road = RivalTracker(1), RoadAhead.of(STRAIGHT)
    tracker.watch(karts((0.0, 8.0)), STILL, road)
    tracker.look()
    first = tracker.watch(karts((0.0, 8.4)), STILL, road)
    again = tracker.watch(karts((0.0, 8.4)), STILL, road)
    assert first.gain[0, 0] == again.gain[0, 0] > 3.9
    tracker.forget(np.array([0]))
    assert tracker.watch(karts((0.0, 8.4)), STILL, road).gain[0, 0] == 0


def test_no_kart_and_many_karts_are_as_good():
    tracker, road = RivalTracker(1), RoadAhead.of(STRAIGHT)
    nobody = tracker.watch(np.zeros((1, 0, 3), np.float32), STILL, road)
    assert not nobody.is_there.any()
    assert nobody.numbers(road.offset).shape == (1, 5 * RIVALS)
    many = tracker.watch(karts(*((0.0, 2.0 + n) for n in range(9))), STILL, road)
    np.testing.assert_allclose(many.along[0], [2, 3, 4, 5], atol=1e-4)


def test_in_a_race_they_are_as_fast_as_the_engine_says():
    errors = []
    with race_v0.parallel_env(num_kart=5, agents=1, track="lighthouse", difficulty=3) as env:
        env.reset(seed=3)
        batched_view, tracker = BatchedRacingView([RoadTable(env.track_map)]), RivalTracker(5)
        idle = {agent: env.action_space(agent).sample() for agent in env.agents}
        for step in range(100):
            env.step(idle)
            karts = env.snapshot.karts
            _, around = batched_view.surroundings([env.snapshot], [0], [np.arange(5)], ALL_LOOKS)
            tracker.look()
            velocity = karts["velocity_lc"]
            seen = tracker.watch(around.karts, velocity, RoadAhead.of(around.road[:, len(LOOKS) :]))
            apart = np.linalg.norm(karts["location"][:, None] - karts["location"], axis=2)
            np.fill_diagonal(apart, np.inf)
            nearest, speed = apart.argmin(axis=1), karts["velocity_lc"][:, 2]
            is_near = seen.is_there[:, 0] & (apart.min(axis=1) < 10) & (step > 40)
            errors += list((seen.gain[:, 0] - (speed[nearest] - speed))[is_near])
    assert len(errors) > 20
    assert np.median(np.abs(errors)) < 1.0
