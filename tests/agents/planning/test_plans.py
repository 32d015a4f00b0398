"""The plans that are available to a kart in each state."""

import numpy as np
import pytest

from stkzoo.agents.planning.motion import BOOST_STEPS, RELEASE_STEPS
from stkzoo.agents.planning.plans import (
    BRAKE,
    DRIFT_LEFT,
    DRIFT_RIGHT,
    FREE,
    LONGEST_DRIFT,
    plan_table,
)
from tests.oracle.plan_viewer import table_rows

TABLE = plan_table(4)
ALL = {FREE, BRAKE, DRIFT_LEFT, DRIFT_RIGHT}


def plans_of(drift_side=0, drift_steps=0, release_steps=0):
    """Returns the columns of the plans available in a state, by plan or by time and plan."""
    state = (np.array([number]) for number in (drift_side, drift_steps, release_steps))
    (row,) = table_rows(*state, (RELEASE_STEPS, LONGEST_DRIFT))
    exists = TABLE.maneuvers[row] >= 0
    names = TABLE._fields[1:]
    return {name: getattr(TABLE, name)[row][..., exists] for name in names}


def begins(**state):
    return set(plans_of(**state)["maneuvers"].tolist())


def test_the_state_limits_how_plans_start():
    assert begins() == ALL
    assert begins(drift_side=1, drift_steps=5) == {FREE, BRAKE, DRIFT_RIGHT}
    assert begins(drift_side=-1, drift_steps=5) == {FREE, BRAKE, DRIFT_LEFT}
    assert begins(drift_side=-1, drift_steps=99) == {FREE, BRAKE}  # the kart has earned both boosts
    assert (TABLE.least <= TABLE.most).all()


@pytest.mark.parametrize("release", range(1, RELEASE_STEPS + 1))
def test_no_drift_starts_while_the_last_one_still_turns_the_kart(release):
    plans = plans_of(release_steps=release)
    assert set(plans["maneuvers"].tolist()) == {FREE, BRAKE}
    assert not plans["drifts"][0].any()
    assert (plans["boosts"] == 0).any()  # drifts start later


def test_only_long_drifts_earn_boosts():
    begin = plans_of()
    starts = np.isin(begin["maneuvers"], (DRIFT_LEFT, DRIFT_RIGHT))
    assert begin["boost_steps"][starts] == pytest.approx(BOOST_STEPS[0])
    assert begin["needs_drift"][starts].all()
    too_short = plans_of(drift_side=1, drift_steps=4)
    ends_now = too_short["maneuvers"] == FREE
    assert not (too_short["boosts"][ends_now] >= 0).any()
    done = plans_of(drift_side=1, drift_steps=BOOST_STEPS[1])
    assert (done["boosts"] == 1).any()


def test_plans_keep_their_lane_without_changes():
    lanes = plan_table(0).lanes
    assert (lanes == lanes[:, :1]).all()
