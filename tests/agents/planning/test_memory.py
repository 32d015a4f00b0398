"""The drivers' memory from step to step."""

import numpy as np
import pytest

from stkzoo.agents.planning.memory import DriverMemory
from stkzoo.agents.planning.motion import STEP
from stkzoo.agents.planning.parameters import DriverParameters


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
