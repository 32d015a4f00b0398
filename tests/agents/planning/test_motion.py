"""How karts move: the planner's constants and its network, compared with karts in races."""

import math
import statistics

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.agents import heuristic
from stkzoo.agents.planning.memory import PlanMemory
from stkzoo.agents.planning.motion import (
    BOOST_STEPS,
    DRIFT_APART,
    DRIFT_TURN,
    MotionState,
    learned_motion,
)
from stkzoo.agents.planning.parameters import DriverParameters


def drive_alone(track, reverse=False):
    """Drives one lap; yields the drift steps before each action, the speed and the action."""
    with race_v0.parallel_env(num_kart=1, track=track, reverse=reverse, max_cycles=None) as env:
        observation = env.reset(seed=2)[0]["kart_0"]
        driver = heuristic.create_state()
        while env.agents:
            _, (drift_steps,), _ = driver.memory.drifts()
            action = driver.drive(observation)
            yield drift_steps, float(observation["velocity"][2]), action
            observation = env.step({"kart_0": action})[0]["kart_0"]


@pytest.mark.slow
def test_drifts_earn_boosts_in_the_game():
    calls = list(drive_alone("lighthouse"))
    ends = [
        number
        for number, (drift_steps, _, action) in enumerate(calls[:-3])
        if drift_steps >= BOOST_STEPS[0] and not action["drift"]
    ]
    assert len(ends) >= 4
    gains = [calls[end + 2][1] - calls[end][1] for end in ends]
    assert statistics.median(gains) > 0.5  # [m/s]; without a boost the median is not above 0


@pytest.mark.slow
def test_the_driver_keeps_the_minimum_interval_between_drifts():
    drifts = [action["drift"] for *_, action in drive_alone("stk_enterprise", reverse=True)]
    begins = np.flatnonzero(np.diff(drifts, prepend=0) == 1)
    assert len(begins) > 10
    assert np.diff(begins).min() >= DRIFT_APART


def control(steer, drift=0):
    return {
        "acceleration": np.ones(1, np.float32),
        "steer": np.array([steer], np.float32),
        "brake": 0,
        "drift": drift,
        "fire": 0,
        "nitro": 0,
        "rescue": 0,
    }


def heading(env):
    w, x, y, z = env.snapshot.karts["rotation"][0]
    return math.atan2(2 * (x * z - w * y), 1 - 2 * (x * x + y * y))


@pytest.fixture(scope="module")
def fast_kart():
    """Yields a fast kart on open road, and its expected turn rate at full lock [rad/s]."""
    with race_v0.parallel_env(num_kart=1, track="gran_paradiso_island", max_cycles=None) as env:
        observation = env.reset(seed=3)[0]["kart_0"]
        while observation["velocity"][2] < 22.0:
            observation = env.step({"kart_0": control(0.0)})[0]["kart_0"]
        speed = float(observation["velocity"][2])
        angle = float(observation["max_steer_angle"][0])
        yield env, speed * math.tan(angle) / DriverParameters().wheel_base


def turns_of(env, controls):
    """Returns the angle that the kart turns to the right with each control [rad]."""
    with env.lookahead() as branch:
        headings = [heading(branch)]
        for action in controls:
            branch.step({"kart_0": action})
            headings.append(heading(branch))
    return np.diff(np.unwrap(headings))


@pytest.mark.slow
def test_the_turn_rate_at_full_lock_is_as_computed(fast_kart):
    env, lock = fast_kart
    for side in (-1, 1):
        turns = turns_of(env, [control(side)] * 3)
        assert turns[1:] * side == pytest.approx(0.1 * lock, rel=0.15)
        assert turns[0] / turns[1] == pytest.approx(1 - 0.33, abs=0.12)  # the lag in weigher.c


def test_a_drift_turns_by_the_expected_fractions_of_full_lock(fast_kart):
    env, lock = fast_kart
    for side in (-1, 1):
        for steer, share in zip((-1, 1), DRIFT_TURN, strict=True):
            drift = [control(0.3 * side, 1), *[control(steer * side, 1)] * 4]
            turn = turns_of(env, drift)[-1] * side
            assert turn == pytest.approx(0.1 * lock * share, rel=0.15)


def motion_on(track):
    """Drives one lap; returns the network's inputs, and the turn and gains of speed after each."""
    steps = []
    with race_v0.parallel_env(num_kart=1, track=track, max_cycles=None) as env:
        observation = env.reset(seed=2)[0]["kart_0"]
        driver = heuristic.create_state()
        while env.agents:
            before = heading(env), *env.snapshot.karts["velocity_lc"][0]
            action = driver.drive(observation)
            steps.append((*before, action["brake"], *driver.memory.rows[:, 0]))
            observation = env.step({"kart_0": action})[0]["kart_0"]
    headings, slide, _, speed, brake, *memory = np.array(steps).T
    known, yaw = PlanMemory(*memory), np.diff(np.unwrap(headings), prepend=headings[0])
    state = MotionState(
        speed=speed,
        slide=slide,
        yaw=yaw,
        turn=known.turn,
        turn_before=np.roll(known.turn, 1),
        side=known.drift_side,
        steps=known.drift_steps,
        release=known.release_steps,
        drift_turn=known.drift_turn,
        boost=known.boost_steps,
        big_boost=known.big_boost_steps,
        brake=brake,
    )
    outputs = np.stack([yaw[1:], np.diff(speed), np.diff(slide)], axis=-1)
    is_fast = speed[:-1] > 3
    return state.inputs()[:-1][is_fast], outputs[is_fast]


@pytest.mark.slow
def test_forecasts_of_a_step_are_close_on_an_unseen_track():
    x, outputs = motion_on("minigolf")
    *hidden, last, bias = learned_motion()
    for matrix, shift in zip(hidden[::2], hidden[1::2], strict=True):
        x = np.maximum(x @ matrix.T + shift, 0)
    errors = np.median(np.abs(x @ last.T + bias - outputs), axis=0)
    spread = np.median(np.abs(outputs), axis=0)
    assert (errors < 0.7 * spread).all()
