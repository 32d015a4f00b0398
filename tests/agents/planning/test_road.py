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
IS_THERE, GAIN = 0, 3


def karts(*places):
    return np.array([(x, 0.0, z) for x, z in places], np.float32).reshape(1, -1, 3)


def around_of(road, spots, velocity=None, max_steer_angle=0.1):
    """Returns surroundings without items, of karts without power-ups."""
    count = len(road)
    own = np.zeros((count, OWN_SIZE), np.float32)
    own[:, :3], own[:, 3] = 0.0 if velocity is None else velocity, max_steer_angle
    items, types = np.zeros((count, 0, 3), np.float32), np.zeros((count, 0), np.int64)
    return Surroundings(own, road, spots, items, types)


def watched(memory, spots, velocity, road):
    """Returns the nearby karts, indexed by kart, rival and column."""
    around = around_of(road, spots, velocity)
    inputs = np.empty((len(road), 39), np.float32)
    weigh(DriverParameters(), memory, around, inputs)
    return inputs[:, 19:].reshape(len(road), RIVALS, 5) * np.array([1, 10, 3, 5, 3], np.float32)


def test_relative_speeds_match_the_engine_in_a_race():
    errors = []
    with race_v0.parallel_env(num_kart=5, agents=1, track="lighthouse", difficulty=3) as env:
        env.reset(seed=3)
        observer, memory = road_observer(env.track_map), DriverMemory(5, DriverParameters())
        idle = {agent: env.action_space(agent).sample() for agent in env.agents}
        for step in range(100):
            env.step(idle)
            karts = env.snapshot.karts
            around = observer.surroundings(env.snapshot, np.arange(5), ALL_LOOKS)
            memory.look(*np.ones((2, 5), np.float32))
            velocity = np.ascontiguousarray(karts["velocity_lc"])
            seen = watched(memory, around.karts, velocity, around.road)
            apart = np.linalg.norm(karts["location"][:, None] - karts["location"], axis=2)
            np.fill_diagonal(apart, np.inf)
            nearest, speed = apart.argmin(axis=1), karts["velocity_lc"][:, 2]
            is_near = (seen[:, 0, IS_THERE] > 0) & (apart.min(axis=1) < 10) & (step > 40)
            errors += list((seen[:, 0, GAIN] - (speed[nearest] - speed))[is_near])
    assert len(errors) > 20
    assert np.median(np.abs(errors)) < 1.0
