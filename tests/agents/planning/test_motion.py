"""The learned motion network, compared with karts in races."""

import numpy as np
import pytest

from stkzoo.agents.planning.motion import learned_motion
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.training.common.matches import Match, plan_match_driver, play_matches
from stkzoo.agents.training.learn_motion import drive, misses


@pytest.mark.slow
def test_one_second_forecasts_beat_arcs_on_an_unseen_track():
    (log,) = drive(["minigolf"], 1, DriverParameters(learned_motion=True), seed=3)
    by_network, by_arcs = (
        np.median(np.abs(missed), axis=0) for missed in misses(log, learned_motion()[1:])
    )
    assert (by_network < 0.6).all()  # [m]
    assert (by_network < 0.5 * by_arcs).all()


@pytest.mark.slow
def test_without_rivals_the_bump_cost_does_not_change_plans_with_the_network():
    rules = {cost: DriverParameters(learned_motion=True, bump_cost=cost) for cost in (0.0, 1.0)}
    plans = RacingPolicy.of_plans_alone()
    drivers = {str(cost): plan_match_driver(plans, own) for cost, own in rules.items()}
    matches = [Match((name,), "olivermath", bots=0, number=1) for name in drivers]
    (ignores,), (watches,) = play_matches(matches, drivers)
    assert ignores.ratio == watches.ratio  # there are no rivals on the road
    assert ignores.ratio < 1.0
