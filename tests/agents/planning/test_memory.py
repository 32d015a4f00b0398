"""The drivers' memory from step to step."""

import numpy as np
import pytest

from stkzoo.agents.planning.memory import DriverMemory
from stkzoo.agents.planning.motion import BOOST_LASTS, BOOST_STEPS, DRIFT_APART, RESCUE_STEPS, STEP
from stkzoo.agents.planning.parameters import DriverParameters


def test_the_memory_keeps_a_drift_and_the_boost_that_it_earns():
    memory, one = DriverMemory(1, DriverParameters()), np.array([1.0], np.float32)
    side, none = np.array([1]), np.array([False])
    fast, skids = 20 * one, 2 * one
    for _ in range(BOOST_STEPS[0]):
        memory.look(fast, skids)
        memory.act(side, 0.5 * one, none, none)
    assert memory.situation().drift_steps[0] == BOOST_STEPS[0]
    memory.act(0 * side, 0 * one, none, none)
    now = memory._of
    assert (now.drift_side[0], now.boost_steps[0]) == (0, BOOST_LASTS[0])
    assert now.drift_turn[0] == 0.5
    memory.look(fast, one)
    assert memory._of.boost_steps[0] == BOOST_LASTS[0] - 1


def test_a_drift_that_the_engine_ends_is_over():
    memory, one = DriverMemory(1, DriverParameters()), np.array([1.0], np.float32)
    none = np.array([False])
    for step in range(6):
        memory.look(20 * one, one)  # the kart does not skid
        if step < 4:
            memory.act(np.array([1]), 0.5 * one, none, none)
    assert memory.situation().drift_side[0] == 0


def test_a_drift_starts_with_a_hop_and_its_release_lasts_as_long_as_a_short_drift():
    memory, one = DriverMemory(1, DriverParameters()), np.array([1.0], np.float32)
    none, may_hop = np.array([False]), []
    for step in range(DRIFT_APART + 1):
        memory.look(20 * one, 2 * one)
        may_hop.append(bool(memory.situation().may_hop[0]))
        memory.act(np.array([int(step < 2)]), 0.5 * one, none, none)
        if step == 2:
            assert memory._of.release_steps[0] == 2
    assert may_hop == [True, *[False] * (DRIFT_APART - 1), True]


def when_a_held_kart_acts(speed=0.0, **rules):
    """Returns the steps in which a stuck kart backs out, and those in which it calls rescue."""
    memory, speeds = DriverMemory(1, DriverParameters(**rules)), np.full(1, speed, np.float32)
    backs, calls = [], []
    for step in range(60):
        memory.look(speeds, np.ones(1))
        back, call = memory.stuck()
        backs += [step] * int(back[0])
        calls += [step] * int(call[0])
    return backs, calls


def test_a_stuck_kart_calls_rescue_and_waits_for_it():
    backs, calls = when_a_held_kart_acts()
    assert calls[0] < backs[0] < calls[1]  # the first rescue did not help
    assert calls[0] == pytest.approx(DriverParameters().stuck_time / STEP, abs=1)
    assert min(np.diff(calls)) >= RESCUE_STEPS


def test_a_stuck_kart_can_back_out_first():
    backs, calls = when_a_held_kart_acts(rescue_reverses=1)
    assert calls[0] > backs[0] + 9


def test_a_crawling_kart_calls_rescue():
    rules = DriverParameters()
    assert when_a_held_kart_acts(rules.crawl_speed + 0.5) == ([], [])
    _, calls = when_a_held_kart_acts(rules.crawl_speed - 0.5)
    assert calls[0] == pytest.approx(rules.crawl_time / STEP, abs=1)


def test_a_kart_far_from_the_road_calls_rescue():
    rules = DriverParameters()
    memory, fast = DriverMemory(2, rules), np.full(2, 20.0, np.float32)
    beyond = rules.lost_room + np.array([-0.5, 0.5], np.float32)
    calls = np.zeros(2, int)
    for _ in range(20):
        memory.look(fast, fast)
        memory.look_around(beyond)
        calls += memory.stuck()[1]
    assert calls.tolist() == [0, 1]


def test_forget_resets_only_the_given_karts():
    memory, twos = DriverMemory(2, DriverParameters()), np.ones(2, np.float32)
    nobody = np.zeros(2, bool)
    memory.look(20 * twos, 2 * twos)
    memory.act(np.array([1, 1]), 0.3 * twos, nobody, ~nobody)
    memory.forget(np.array([0]))
    one, two = memory.numbers()
    assert (one == DriverMemory(1, DriverParameters()).numbers()[0]).all()
    assert (two != one).any()
