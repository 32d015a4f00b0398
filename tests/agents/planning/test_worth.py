"""What the plans of learned drivers are worth, on a straight road."""

import numpy as np
import pytest

from stkzoo.agents.planning.memory import KartSituation
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.plans import BRAKE, FREE
from stkzoo.agents.planning.rivals import Rivals
from stkzoo.agents.planning.road import LINE_MARKS, RoadAhead
from stkzoo.agents.planning.worth import NEVER, PlanScene, weigh

STRAIGHT = np.zeros((1, len(LINE_MARKS), 4), np.float32)
STRAIGHT[0, :, 2], STRAIGHT[0, :, 3] = LINE_MARKS, 5.0


def weighed(speed=25.0, ahead=0.0, closing=0.0, across=0.0, **rules):
    """The plans without drifts of a kart; a rival is so far ahead, if at all."""
    one, none = np.ones(1, np.float32), np.zeros(1, np.intp)
    zero, false = 0 * one, one < 0

    def of_first(number):
        return np.array([[number, 0.0, 0.0, 0.0]], np.float32)

    rivals = Rivals(
        is_there=of_first(ahead) > 0,
        along=of_first(ahead),
        across=of_first(across),
        gain=of_first(-closing),
        drift=of_first(0.0),
    )
    scene = PlanScene(
        speed=speed * one,
        max_steer_angle=0.06 * one,
        is_jumping=false,
        has_powerup=false,
        road=RoadAhead.of(STRAIGHT),
        items=np.zeros((1, 0, 3), np.float32),
        item_types=np.zeros((1, 0), np.intp),
        rivals=rivals,
    )
    now = KartSituation(zero, zero, none, none, false, none, zero, zero, false)
    return weigh(scene, now, DriverParameters(**rules))


def test_plans_go_round_a_slower_kart_ahead():
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
def test_plans_leave_karts_alone_that_are_not_in_the_way(rival):
    seen, alone = weighed(**rival), weighed()
    assert seen.turn[0, FREE] == alone.turn[0, FREE]
    assert seen.worth[0, FREE] == alone.worth[0, FREE]


def test_nobody_brakes_who_would_drive_backwards():
    slowest = DriverParameters().brake_speed
    assert weighed(slowest - 0.1).worth[0, BRAKE] == NEVER
    assert weighed(slowest + 0.1).worth[0, BRAKE] > NEVER
