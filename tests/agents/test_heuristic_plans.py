"""What the heuristic driver foresees, and whether the game agrees."""

import math
import statistics

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.agents import heuristic
from stkzoo.agents.heuristic.forecast import Motion, forecast
from stkzoo.agents.heuristic.line import CentreLine
from stkzoo.agents.heuristic.plans import (
    ITEM_LANES,
    SPANS,
    plans_in_drift,
    plans_without_drift,
)
from stkzoo.agents.heuristic.road import COUNT, Road
from stkzoo.agents.planning.kart import (
    BOOST_STEPS,
    DRIFT_APART,
    DRIFT_TURN,
    RELEASE_STEPS,
    RELEASE_TURN,
    STEERING_LAG,
)

RADIUS = 60.0
LOCK = 1.45
CHANGES = heuristic.DriverParameters().lane_changes


def line_of(points, half_width=6.0):
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    return CentreLine(points, marks, np.full(len(points), half_width))


def straight_road(offset=0.0):
    z = np.arange(0.0, 300.0, 2.0)
    return Road.of(line_of(np.stack([np.full_like(z, -offset), 0 * z, z], axis=1)))


def right_bend():
    way = np.arange(0.0, 150.0, 2.0) / RADIUS
    x, z = RADIUS * (1 - np.cos(way)), RADIUS * np.sin(way)
    return Road.of(line_of(np.stack([x, 0 * x, z], axis=1)))


def foresee(plans, road, items=(0.0,) * ITEM_LANES):
    room = road.half_widths - 1.0
    return forecast(plans, road, room, Motion(25.0, LOCK, 0.0, 0.0), 12.0, np.array(items))


def free_lanes(plans):
    return (plans.boosts < 0) & ~plans.brakes & (plans.items < 0)


def test_a_bend_to_the_right_is_curved_to_the_right():
    assert right_bend().curvature[2:20] == pytest.approx(1 / RADIUS, rel=0.05)


def test_spots_are_found_along_and_across_the_road():
    turn = 0.5
    spot = [RADIUS - (RADIUS - 3) * math.cos(turn), 1.0, (RADIUS - 3) * math.sin(turn)]
    (along,), (across,), (above,) = right_bend().place(np.array([spot]))
    assert along == pytest.approx(turn * RADIUS, abs=0.5)
    assert across == pytest.approx(3.0, abs=0.1)  # nearer to the bend's middle is right
    assert above == pytest.approx(1.0)


def test_the_road_knows_where_the_kart_is():
    assert straight_road(offset=2.5).offset == pytest.approx(2.5)
    assert straight_road().bends(30.0) == pytest.approx(np.zeros(COUNT))


def test_a_plan_gets_to_its_lane_and_stays_on_the_road():
    plans = plans_without_drift(0, False, CHANGES)
    ways = foresee(plans, straight_road(offset=-2.0))
    free = free_lanes(plans)
    kept = free & (plans.lanes[0] == plans.lanes[-1])
    assert ways.across[-1, kept] == pytest.approx(5.0 * plans.lanes[0, kept], abs=0.6)
    assert np.abs(ways.across[:, free]).max() < 5.5


def test_a_plan_may_change_its_lane_on_the_way():
    plans = plans_without_drift(0, False, CHANGES)
    ways = foresee(plans, straight_road())
    before, after = plans.lanes[0], plans.lanes[-1]
    swings = free_lanes(plans) & (before < -0.5) & (after > 0.5)
    assert swings.any()
    assert (ways.across[5, swings] < -1.0).all()  # after 0.8 s
    assert (ways.across[-1, swings] > 3.0).all()
    kept = plans_without_drift(0, False, 0).lanes
    assert (kept == kept[0]).all()


def test_a_plan_gets_to_its_item():
    plans = plans_without_drift(0, False, CHANGES)
    ways = foresee(plans, straight_road(), items=(3.3, -1.7))
    for item, across in enumerate((3.3, -1.7)):
        chosen = (plans.items == item) & ~plans.brakes
        assert ways.across[-1, chosen] == pytest.approx(across, abs=0.5)
    assert ways.along[-1].max() == pytest.approx(25.0 * SPANS.sum(), rel=0.02)


def test_the_inner_side_of_a_bend_is_the_shorter_way():
    plans = plans_without_drift(0, False, CHANGES)
    ways = foresee(plans, right_bend())
    free = free_lanes(plans) & (plans.lanes[0] == plans.lanes[-1])
    along = ways.along[-1, free][np.argsort(plans.lanes[0, free])]
    assert along[-1] > along[len(along) // 2] > along[0]


def test_brakes_cost_way():
    plans = plans_without_drift(0, False, CHANGES)
    ways = foresee(plans, straight_road())
    assert ways.along[-1, plans.brakes].max() < ways.along[-1, ~plans.brakes].min()


@pytest.mark.parametrize("side", [-1, 1])
def test_a_drift_turns_at_least_so_much(side):
    plans = plans_in_drift(side, 3, CHANGES)
    drifting = plans.drifts[0]
    turns = foresee(plans, straight_road()).turns[drifting] * side
    assert (turns >= DRIFT_TURN[0] - 1e-9).all()
    assert (turns <= DRIFT_TURN[1] + 1e-9).all()
    assert set(plans.sides[drifting]) == {side}


def test_no_drift_begins_while_the_last_one_still_turns_the_kart():
    for release in range(1, RELEASE_STEPS + 1):
        plans = plans_without_drift(release, True, CHANGES)
        assert (plans.boosts == 0).any()
        assert not plans.sides.any()
        assert not plans.drifts[0].any()


def test_boosts_are_earned_by_drifts_that_last():
    begin = plans_without_drift(0, True, CHANGES)
    assert begin.boost_steps[begin.sides != 0] == pytest.approx(BOOST_STEPS[0])
    too_short = plans_in_drift(1, 4, CHANGES)
    assert not (too_short.boosts[too_short.sides == 0] >= 0).any()
    done = plans_in_drift(1, BOOST_STEPS[1], CHANGES)
    assert not done.sides.any()
    assert (done.boosts == 1).any()


def drive_alone(track, reverse=False):
    """Calls of the driver on a lap: what it remembers before each, and the speed."""
    with race_v0.parallel_env(num_kart=1, track=track, reverse=reverse, max_cycles=None) as env:
        observation = env.reset(seed=2)[0]["kart_0"]
        driver, state = heuristic.HeuristicDriver(), heuristic.create_state()
        while env.agents:
            drift_steps = state.drift_steps
            action = driver(state, observation)
            yield drift_steps, float(observation["velocity"][2]), action
            observation = env.step({"kart_0": action})[0]["kart_0"]


def test_drifts_earn_boosts_in_the_game():
    calls = list(drive_alone("lighthouse"))
    ends = [
        number
        for number, (drift_steps, _, action) in enumerate(calls[:-3])
        if drift_steps >= BOOST_STEPS[0] and not action["drift"]
    ]
    assert len(ends) >= 4
    gains = [calls[end + 2][1] - calls[end][1] for end in ends]
    assert statistics.median(gains) > 0.5  # m/s; without a boost the speed is not above 0


def test_drifts_do_not_begin_too_soon_after_one_another():
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
    """A kart at speed with room around it, and how fast it turns at full lock, reckoned [rad/s]."""
    with race_v0.parallel_env(num_kart=1, track="gran_paradiso_island", max_cycles=None) as env:
        observation = env.reset(seed=3)[0]["kart_0"]
        while observation["velocity"][2] < 22.0:
            observation = env.step({"kart_0": control(0.0)})[0]["kart_0"]
        speed = float(observation["velocity"][2])
        angle = float(observation["max_steer_angle"][0])
        yield env, speed * math.tan(angle) / heuristic.DriverParameters().wheel_base


def turns_of(env, controls):
    """How far the kart turns with each control, to the right [rad]."""
    with env.lookahead() as branch:
        headings = [heading(branch)]
        for action in controls:
            branch.step({"kart_0": action})
            headings.append(heading(branch))
    return np.diff(np.unwrap(headings))


def test_full_lock_turns_as_fast_as_reckoned(fast_kart):
    env, lock = fast_kart
    for side in (-1, 1):
        turns = turns_of(env, [control(side)] * 3)
        assert turns[1:] * side == pytest.approx(0.1 * lock, rel=0.15)
        assert turns[0] / turns[1] == pytest.approx(1 - STEERING_LAG, abs=0.12)


def test_a_drift_turns_by_its_shares(fast_kart):
    env, lock = fast_kart
    for side in (-1, 1):
        for steer, share in zip((-1, 1), DRIFT_TURN, strict=True):
            drift = [control(0.3 * side, 1), *[control(steer * side, 1)] * 4]
            turn = turns_of(env, drift)[-1] * side
            assert turn == pytest.approx(0.1 * lock * share, rel=0.15)


def test_a_kart_goes_on_turning_after_a_drift_and_cannot_begin_another(fast_kart):
    env, _ = fast_kart
    drift = [control(0.3, 1), *[control(-1.0, 1)] * 7]
    after = turns_of(env, [*drift, *[control(0.0)] * 4])[len(drift) + 1 :]
    assert after == pytest.approx(0.1 * RELEASE_TURN * DRIFT_TURN[0], rel=0.3)
    again = turns_of(env, [*drift, control(0.0), *[control(-0.01, 1)] * 3])[len(drift) + 1 :]
    assert again == pytest.approx(after[:3], abs=0.01)  # in a drift it would turn left


@pytest.mark.parametrize("steps", [2, 4])
def test_after_a_short_drift_a_kart_turns_on_for_as_long_as_it_drifted(fast_kart, steps):
    env, _ = fast_kart
    drift = [control(0.3, 1), *[control(-1.0, 1)] * (steps - 1)]
    after = turns_of(env, [*drift, *[control(0.0)] * 8])[steps + 1 :]
    is_turning = after > 0.05 * RELEASE_TURN * DRIFT_TURN[0]
    assert is_turning.tolist() == [step < steps - 1 for step in range(len(after))]


@pytest.mark.parametrize("apart", range(2, 8))
def test_a_drift_that_begins_too_soon_begins_late_and_to_the_wrong_side(fast_kart, apart):
    env, _ = fast_kart
    short = [control(0.3, 1), *[control(0.0)] * (apart - 1)]
    # a drift to the right is begun, and widened at once by steering against it
    again = turns_of(env, [*short, control(0.3, 1), *[control(-1.0, 1)] * 4])[-1]
    assert (again > 0) == (apart >= DRIFT_APART)
