"""The values of learned drivers' plans on a straight road."""

import numpy as np
import pytest

from stkzoo.agents.planning.memory import DriverMemory
from stkzoo.agents.planning.motion import STEP
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.plans import BRAKE, FREE
from stkzoo.agents.planning.worth import NEVER, weigh
from tests.agents.planning.test_road import STRAIGHT, around_of, karts


def weighed(speed=25.0, ahead=0.0, closing=0.0, across=0.0, **rules):
    """Returns the plans without drifts. A rival is ``ahead`` meters in front; 0 for no rival."""
    parameters = DriverParameters(**rules)
    memory = DriverMemory(1, parameters)
    memory._of.hop_steps[:] = 1
    memory.moments[0, 0, :2], memory.moments[0, 0, 8:10] = (
        (across, ahead + closing * STEP),
        (0, speed),
    )
    spots = karts((across, ahead)) if ahead else karts()
    around = around_of(STRAIGHT, spots, (0.0, 0.0, speed), max_steer_angle=0.06)
    return weigh(parameters, memory, around, np.empty((1, 39), np.float32))


def test_plans_pass_a_slower_kart_ahead():
    alone, behind = weighed(), weighed(ahead=12.0, closing=8.0)
    assert abs(alone.turn[0, FREE]) < 0.01
    assert abs(behind.turn[0, FREE]) > 0.05
    assert behind.worth[0, FREE] > alone.worth[0, FREE] - 2.0
    for side in (-1, 1):
        turn = weighed(ahead=12.0, closing=8.0, across=0.8 * side).turn[0, FREE]
        assert np.sign(turn) == -side


@pytest.mark.parametrize(
    "rival",
    [
        {"ahead": 12.0, "closing": -3.0},
        {"ahead": 60.0, "closing": 8.0},
        {"ahead": 12.0, "closing": 8.0, "across": 4.0},
        {"ahead": 12.0, "closing": 8.0, "bump_cost": 0.0},
    ],
)
def test_plans_ignore_karts_that_are_not_in_the_way(rival):
    seen, alone = weighed(**rival), weighed()
    assert seen.turn[0, FREE] == alone.turn[0, FREE]
    assert seen.worth[0, FREE] == alone.worth[0, FREE]


def test_plans_do_not_brake_below_the_minimum_speed():
    slowest = DriverParameters().brake_speed
    assert weighed(slowest - 0.1).worth[0, BRAKE] == NEVER
    assert weighed(slowest + 0.1).worth[0, BRAKE] > NEVER
