"""Tracking of nearby karts between steps, compared with the engine's values."""

import numpy as np

from stkzoo import race_v0
from stkzoo.agents.planning.driver import ALL_LOOKS
from stkzoo.agents.planning.memory import DriverMemory
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.road import LINE_MARKS, RIVALS, RivalTracker
from stkzoo.agents.planning.worth import OwnState, plan_rules, weigh
from stkzoo.wrappers.racing import Surroundings, road_observer

STRAIGHT = np.zeros((1, len(LINE_MARKS), 4), np.float32)
STRAIGHT[0, :, 2], STRAIGHT[0, :, 3] = LINE_MARKS, 5.0
IS_THERE, ALONG, ACROSS, GAIN, DRIFT = range(5)


def karts(*places):
    return np.array([(x, 0.0, z) for x, z in places], np.float32).reshape(1, -1, 3)


def own_of(velocity=None, speed=0.0):
    """Returns the own state of karts without power-ups."""
    velocity = np.array([[0.0, 0.0, speed]], np.float32) if velocity is None else velocity
    count = len(velocity)
    none = np.zeros(count, np.int64)
    return OwnState(velocity, np.zeros((count, 1), np.float32), none, none, none)


def around_of(road, spots):
    """Returns surroundings without items."""
    count = len(road)
    items, types = np.zeros((count, 0, 3), np.float32), np.zeros((count, 0), np.int64)
    return Surroundings(road, spots, items, types)


def watched(tracker, spots, velocity=None, road=STRAIGHT):
    """Returns the nearby karts, indexed by kart, rival and column."""
    own, rules = own_of(velocity), DriverParameters()
    count = len(own.velocity)
    memory, lock = DriverMemory(count, rules).rows, np.full((count, 1), 0.1, np.float32)
    return weigh(plan_rules(rules), memory, own, lock, around_of(road, spots), tracker).rivals


def test_two_nearby_karts_are_tracked_separately():
    tracker = RivalTracker(1)
    watched(tracker, karts((1.0, 6.0), (-2.0, 12.0)))
    tracker.look()
    seen = watched(tracker, karts((-1.9, 11.8), (1.3, 6.5)))
    assert (seen[..., IS_THERE] > 0).tolist() == [[True, True, False, False]]
    np.testing.assert_allclose(seen[0, :2, ALONG], [6.5, 11.8], atol=1e-4)
    np.testing.assert_allclose(seen[0, :2, ACROSS], [1.3, -1.9], atol=1e-4)
    np.testing.assert_allclose(seen[0, :2, GAIN], [5.0, -2.0], atol=1e-3)
    np.testing.assert_allclose(seen[0, :2, DRIFT], [3.0, 1.0], atol=1e-3)


def test_a_new_kart_has_no_relative_speed_yet():
    tracker = RivalTracker(1)
    watched(tracker, karts((0.0, 20.0)))
    tracker.look()
    seen = watched(tracker, karts((0.0, 10.0), (np.inf, np.inf)))
    assert seen[..., IS_THERE].sum() == 1
    assert seen[0, 0, GAIN] == 0
    assert seen[0, 0, DRIFT] == 0


def test_the_karts_own_motion_is_subtracted():
    tracker = RivalTracker(1)
    turn, way = 0.12, 2.0
    velocity = np.array([[0.0, 0.0, 20.0]], np.float32)
    watched(tracker, karts((1.0, 9.0)), velocity)
    tracker.look()
    # the same road and a standing kart, seen after an arc of 2 m to the right
    start = way * np.array([np.sin(turn / 2), np.cos(turn / 2)])
    x, z = np.array([1.0, 9.0]) - start
    line = STRAIGHT.copy()
    line[0, :, 0] = -start[0] * np.cos(turn) - np.sin(turn) * LINE_MARKS
    line[0, :, 2] = -start[0] * np.sin(turn) + np.cos(turn) * LINE_MARKS
    spot = x * np.cos(turn) - z * np.sin(turn), x * np.sin(turn) + z * np.cos(turn)
    seen = watched(tracker, karts(spot), velocity, line)
    np.testing.assert_allclose(seen[0, 0, GAIN], -20.0, atol=0.01)
    np.testing.assert_allclose(seen[0, 0, DRIFT], 0.0, atol=0.01)


def test_a_repeated_look_changes_nothing_and_forget_clears_the_memory():
    tracker = RivalTracker(1)
    watched(tracker, karts((0.0, 8.0)))
    tracker.look()
    first = watched(tracker, karts((0.0, 8.4)))
    again = watched(tracker, karts((0.0, 8.4)))
    assert first[0, 0, GAIN] == again[0, 0, GAIN] > 3.9
    tracker.forget(np.array([0]))
    assert watched(tracker, karts((0.0, 8.4)))[0, 0, GAIN] == 0


def test_any_number_of_rivals_is_accepted():
    tracker = RivalTracker(1)
    nobody = watched(tracker, karts())
    assert not nobody.any()
    assert nobody.shape == (1, RIVALS, 5)
    many = watched(tracker, karts(*((0.0, 2.0 + n) for n in range(9))))
    np.testing.assert_allclose(many[0, :, ALONG], [2, 3, 4, 5], atol=1e-4)


def test_relative_speeds_match_the_engine_in_a_race():
    errors = []
    with race_v0.parallel_env(num_kart=5, agents=1, track="lighthouse", difficulty=3) as env:
        env.reset(seed=3)
        observer, tracker = road_observer(env.track_map), RivalTracker(5)
        idle = {agent: env.action_space(agent).sample() for agent in env.agents}
        for step in range(100):
            env.step(idle)
            karts = env.snapshot.karts
            _, around = observer.surroundings(env.snapshot, np.arange(5), ALL_LOOKS)
            tracker.look()
            velocity = np.ascontiguousarray(karts["velocity_lc"])
            seen = watched(tracker, around.karts, velocity, around.road)
            apart = np.linalg.norm(karts["location"][:, None] - karts["location"], axis=2)
            np.fill_diagonal(apart, np.inf)
            nearest, speed = apart.argmin(axis=1), karts["velocity_lc"][:, 2]
            is_near = (seen[:, 0, IS_THERE] > 0) & (apart.min(axis=1) < 10) & (step > 40)
            errors += list((seen[:, 0, GAIN] - (speed[nearest] - speed))[is_near])
    assert len(errors) > 20
    assert np.median(np.abs(errors)) < 1.0
