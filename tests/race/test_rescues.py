"""Counts of rescues."""

import numpy as np
import pytest

from stkzoo.engine.snapshot import KART_DTYPE
from stkzoo.engine.starting import TICK
from stkzoo.race import Driver, RaceListener, run_race
from stkzoo.race.rescues import RescueCounter

#: Steps per second. At 7, 25 and 50, a step is not a whole number of the engine's ticks.
RATES = (5, 7, 10, 20, 25, 30, 50, 60, 120)


class StepSize(RaceListener):
    """Sets the game time of a step."""

    def __init__(self, step_size):
        self.step_size = step_size

    def env_options(self):
        return {"step_size": self.step_size}


def asks_for_rescues_at(*steps):
    """Returns a driver that stands still and requests a rescue in the given steps."""
    buttons = dict.fromkeys(("brake", "drift", "fire", "nitro"), 0)
    still = {name: np.zeros(1, np.float32) for name in ("acceleration", "steer")}

    def make(*_):
        count = iter(range(10**6))
        return lambda _: {**buttons, **still, "rescue": int(next(count) in steps)}

    return Driver.of_actor("caller", make)


@pytest.mark.slow
@pytest.mark.parametrize("rate", RATES)
def test_rescues_are_counted_at_each_rate(rate):
    first, soon, second = (round(time * rate) for time in (4.0, 4.2, 7.5))
    drivers = [
        asks_for_rescues_at(first, second),
        asks_for_rescues_at(),
        asks_for_rescues_at(first, soon),
    ]
    options = {"track": "snowtuxpeak", "start_positions": [3, 2, 1], "max_steps": 11 * rate}
    result = run_race(drivers, listeners=[StepSize(1 / rate)], **options)
    by_agent = {row.agent: row.rescues for row in result.agents}
    assert by_agent == {"kart_0": 2, "kart_1": 0, "kart_2": 1}


def flight(times, heights, speed=0.0):
    """Yields the state of a kart whose body is out of the world, far from the origin."""
    for time, height in zip(times, heights, strict=True):
        karts = np.zeros(1, KART_DTYPE)
        karts["location"][0] = (1000.0, height, -700.0)
        karts["speed"] = speed
        yield karts, float(np.float32(time))


@pytest.mark.parametrize("rate", RATES)
def test_an_explosion_does_not_count_as_a_rescue(rate):
    ticks = np.floor(np.arange(0, 1.5, 1 / rate) / TICK + 1e-9)
    times = ticks * TICK
    thrown = np.maximum(0.0, 7.0 * times - 4.9 * times**2) + 100.0
    let_down = np.where(times < 0.5, 100.0 + times, 103.0 - 1.67 * times)
    for heights, speed, rescues in ((thrown, 0.0, 0), (let_down, 0.0, 1), (let_down, 3.0, 0)):
        counter = RescueCounter(1)
        for karts, time in flight(60.0 + times, heights, speed):
            counter.update(karts, time)
        assert counter.counts.tolist() == [rescues]
