"""Tracking of nearby karts between steps, compared with the engine's values."""

import numpy as np

from stkzoo import race_v0
from stkzoo.agents.planning.driver import ALL_LOOKS
from stkzoo.agents.planning.memory import LINE_MARKS, RIVALS, DriverMemory
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.worth import weigh
from stkzoo.wrappers.racing import OWN_SIZE, Surroundings, road_observer

STRAIGHT = np.zeros((1, len(LINE_MARKS), 4), np.float32)
STRAIGHT[0, :, 2], STRAIGHT[0, :, 3] = LINE_MARKS, 5.0
IS_THERE, ALONG, ACROSS, GAIN, DRIFT = range(5)


def karts(*places):
    return np.array([(x, 0.0, z) for x, z in places], np.float32).reshape(1, -1, 3)


def around_of(road, spots, velocity=None, max_steer_angle=0.1):
    """Returns surroundings without items, of karts without power-ups."""
    count = len(road)
    own = np.zeros((count, OWN_SIZE), np.float32)
    own[:, :3], own[:, 3] = 0.0 if velocity is None else velocity, max_steer_angle
    items, types = np.zeros((count, 0, 3), np.float32), np.zeros((count, 0), np.int64)
    return Surroundings(own, road, spots, items, types)


def watched(memory, spots, velocity=None, road=STRAIGHT):
    """Returns the nearby karts, indexed by kart, rival and column."""
    around = around_of(road, spots, velocity)
    inputs = np.empty((len(road), 39), np.float32)
    offset = weigh(DriverParameters(), memory, around, inputs).offset
    seen = inputs[:, 19:].reshape(len(road), RIVALS, 5) * np.array([1, 10, 3, 5, 3], np.float32)
    seen[..., ACROSS] += offset[:, None] * seen[..., IS_THERE]
    return seen


def memory_of(count=1):
    return DriverMemory(count, DriverParameters())


def look(memory):
    """Passes a step."""
    memory.look(*np.ones((2, len(memory.moments)), np.float32))


def test_two_nearby_karts_are_tracked_separately():
    memory = memory_of()
    watched(memory, karts((1.0, 6.0), (-2.0, 12.0)))
    look(memory)
    seen = watched(memory, karts((-1.9, 11.8), (1.3, 6.5)))
    assert (seen[..., IS_THERE] > 0).tolist() == [[True, True, False, False]]
    np.testing.assert_allclose(seen[0, :2, ALONG], [6.5, 11.8], atol=1e-4)
    np.testing.assert_allclose(seen[0, :2, ACROSS], [1.3, -1.9], atol=1e-4)
    np.testing.assert_allclose(seen[0, :2, GAIN], [5.0, -2.0], atol=1e-3)
    np.testing.assert_allclose(seen[0, :2, DRIFT], [3.0, 1.0], atol=1e-3)


def test_a_new_kart_has_no_relative_speed_yet():
    memory = memory_of()
    watched(memory, karts((0.0, 20.0)))
    look(memory)
    seen = watched(memory, karts((0.0, 10.0), (np.inf, np.inf)))
    assert seen[..., IS_THERE].sum() == 1
    assert seen[0, 0, GAIN] == 0
    assert seen[0, 0, DRIFT] == 0


def test_the_karts_own_motion_is_subtracted():
    memory = memory_of()
    turn, way = 0.12, 2.0
    velocity = np.array([[0.0, 0.0, 20.0]], np.float32)
    watched(memory, karts((1.0, 9.0)), velocity)
    look(memory)
    # the same road and a standing kart, seen after an arc of 2 m to the right
    start = way * np.array([np.sin(turn / 2), np.cos(turn / 2)])
    x, z = np.array([1.0, 9.0]) - start
    line = STRAIGHT.copy()
    line[0, :, 0] = -start[0] * np.cos(turn) - np.sin(turn) * LINE_MARKS
    line[0, :, 2] = -start[0] * np.sin(turn) + np.cos(turn) * LINE_MARKS
    spot = x * np.cos(turn) - z * np.sin(turn), x * np.sin(turn) + z * np.cos(turn)
    seen = watched(memory, karts(spot), velocity, line)
    np.testing.assert_allclose(seen[0, 0, GAIN], -20.0, atol=0.01)
    np.testing.assert_allclose(seen[0, 0, DRIFT], 0.0, atol=0.01)


def test_a_repeated_look_changes_nothing_and_forget_clears_the_memory():
    memory = memory_of()
    watched(memory, karts((0.0, 8.0)))
    look(memory)
    first = watched(memory, karts((0.0, 8.4)))
    again = watched(memory, karts((0.0, 8.4)))
    assert first[0, 0, GAIN] == again[0, 0, GAIN] > 3.9
    memory.forget(np.array([0]))
    assert watched(memory, karts((0.0, 8.4)))[0, 0, GAIN] == 0


def test_any_number_of_rivals_is_accepted():
    memory = memory_of()
    nobody = watched(memory, karts())
    assert not nobody.any()
    assert nobody.shape == (1, RIVALS, 5)
    many = watched(memory, karts(*((0.0, 2.0 + n) for n in range(9))))
    np.testing.assert_allclose(many[0, :, ALONG], [2, 3, 4, 5], atol=1e-4)


def test_relative_speeds_match_the_engine_in_a_race():
    errors = []
    with race_v0.parallel_env(num_kart=5, agents=1, track="lighthouse", difficulty=3) as env:
        env.reset(seed=3)
        observer, memory = road_observer(env.track_map), memory_of(5)
        idle = {agent: env.action_space(agent).sample() for agent in env.agents}
        for step in range(100):
            env.step(idle)
            karts = env.snapshot.karts
            around = observer.surroundings(env.snapshot, np.arange(5), ALL_LOOKS)
            look(memory)
            velocity = np.ascontiguousarray(karts["velocity_lc"])
            seen = watched(memory, around.karts, velocity, around.road)
            apart = np.linalg.norm(karts["location"][:, None] - karts["location"], axis=2)
            np.fill_diagonal(apart, np.inf)
            nearest, speed = apart.argmin(axis=1), karts["velocity_lc"][:, 2]
            is_near = (seen[:, 0, IS_THERE] > 0) & (apart.min(axis=1) < 10) & (step > 40)
            errors += list((seen[:, 0, GAIN] - (speed[nearest] - speed))[is_near])
    assert len(errors) > 20
    assert np.median(np.abs(errors)) < 1.0
