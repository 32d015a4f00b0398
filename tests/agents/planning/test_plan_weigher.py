"""The ways of plans. ``test_plan_viewer.py`` compares the extension with the oracle."""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.memory import LINE_MARKS, MARK_COUNT, MARK_SPACING
from stkzoo.agents.planning.motion import DRIFT_TURN, RELEASE_STEPS, learned_motion
from stkzoo.agents.planning.parameters import DriverParameters, rule_numbers
from stkzoo.agents.planning.plans import BRAKE, LONGEST_DRIFT, plan_table
from tests.agents.planning.test_plan_viewer import planned, scene_arguments
from tests.oracle import plan_viewer, plan_weigher
from tests.oracle.plan_viewer import headings_of, table_rows, write_road
from tests.oracle.road_ahead import RoadAhead

RADIUS, LOCK, SPEED, REACH = 60.0, 1.45, 25.0, 12.0
RULES = DriverParameters()


def road_of(x, z, left=6.0, right=6.0):
    line = np.zeros((1, len(LINE_MARKS), 5), np.float32)
    line[0, :, 0], line[0, :, 2], line[0, :, 3], line[0, :, 4] = x, z, left, right
    return RoadAhead.of(line, headings_of(line), MARK_SPACING)


def straight_road(offset=0.0, **edges):
    return road_of(-offset, LINE_MARKS, **edges)


class Ways:
    """The available plans of one kart and their paths, from the reference implementation.

    Args:
        road: the road.
        changes: number of lanes between which plans change.
        state: drift side, drift steps and release steps.
        items: distances of the next good items across the road [m].
        motion: the network of the karts' motion, or nothing.
    """

    def __init__(
        self,
        road,
        *,
        changes=RULES.lane_changes,
        state=(0, 0, 0),
        items=(0.0, 0.0),
        motion=(),
    ):
        table = plan_table(changes)
        rows = table_rows(*(np.array([number]) for number in state), (RELEASE_STEPS, LONGEST_DRIFT))
        (offset,), (angle,) = road.offset, road.angle
        kart = [SPEED, LOCK, REACH, 0, 0, offset, angle, 0, 0, 1, 1, 0, 0, *state]
        columns = np.zeros((1, 2, 4))
        columns[0, :, 1], columns[0, :, 2] = items, 1.0
        rooms = road.left - 1.0, road.right - 1.0
        marks = np.empty((1, 4, MARK_COUNT), np.float32)
        write_road(road, np.array([REACH], np.float32), rooms, marks)
        karts = np.array([kart], np.float32)
        drive = plan_weigher.drive_by_network if motion else plan_weigher.drive_arcs
        self.along, self.across, _, _, turns = drive(table, motion, rows, karts, marks, columns)
        exists = table.maneuvers[rows[0]] >= 0
        self.along, self.across = self.along[:, 0, exists], self.across[:, 0, exists]
        self.turns = turns[0, exists]
        self.lanes = table.lanes[rows[0]][:, exists]
        self.drifts = table.drifts[rows[0]][:, exists] > 0
        self.items, self.maneuvers, self.boosts = (
            column[rows[0]][exists] for column in (table.items, table.maneuvers, table.boosts)
        )

    @property
    def free(self):
        """Mask of the plans without a drift, brake or item."""
        return (self.boosts < 0) & (self.maneuvers != BRAKE) & (self.items < 0)

    @property
    def kept(self):
        """Mask of the free plans that keep to one lane."""
        return self.free & (self.lanes[0] == self.lanes[-1])


@pytest.mark.parametrize("motion", [(), learned_motion()], ids=["arcs", "network"])
@pytest.mark.parametrize("side", [-1, 1])
def test_plans_reach_farther_to_the_side_with_more_room(side, motion):
    left, right = (3.0, 7.0) if side > 0 else (7.0, 3.0)
    ways = Ways(straight_road(left=left, right=right), motion=motion)
    lanes, across = ways.lanes[0, ways.kept], ways.across[-1, ways.kept]
    assert across == pytest.approx(np.where(lanes > 0, right - 1, left - 1) * lanes, abs=0.7)
    assert across.max() == pytest.approx(right - 1, abs=0.7)
    assert across.min() == pytest.approx(1 - left, abs=0.7)


@pytest.mark.parametrize("motion", [(), learned_motion()], ids=["arcs", "network"])
@pytest.mark.parametrize("plan", [_planning.plan_karts, plan_viewer.plan_karts])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_cost_begins_at_the_edge_of_that_side(side, plan, motion):
    narrow, wide = 2.0, 6.0
    rules = rule_numbers(DriverParameters(margin=0.0, greatest_room=9.0, caution_room=9.0))

    def danger(offset):
        """Returns the cost at an offset toward the wide side."""
        (_, worths, table, _, logits), memory, around, line, *rest = scene_arguments(0, count=1)
        table = table._replace(lanes=np.zeros_like(table.lanes))  # all plans steer to the middle
        around[0][:, :3], around[3][:], memory[:] = (0, 0, SPEED), 0, 0
        line[..., :3] = np.stack([0 * LINE_MARKS - side * offset, 0 * LINE_MARKS, LINE_MARKS], -1)
        line[..., 3:] = (narrow, wide) if side > 0 else (wide, narrow)
        arguments = (rules, worths, table, motion, logits), memory, around, line, *rest
        return planned(plan, arguments)["best"][2, 0, 0]

    assert danger(wide - 0.5) == 0 == danger(0.5 - narrow)
    assert danger(wide + 3.0) > 0
    assert danger(-narrow - 3.0) > 0


def test_a_plan_reaches_its_item():
    ways = Ways(straight_road(), items=(3.3, -1.7))
    for item, across in enumerate((3.3, -1.7)):
        chosen = (ways.items == item) & (ways.boosts < 0) & (ways.maneuvers != BRAKE)
        assert ways.across[-1, chosen] == pytest.approx(across, abs=0.5)
    spans = plan_table(RULES.lane_changes).spans
    assert ways.along[-1].max() == pytest.approx(SPEED * spans.sum(), rel=0.02)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_drift_keeps_to_its_range_of_turns(side):
    ways = Ways(straight_road(), state=(side, 3, 0))
    turns = ways.turns[ways.drifts[0]] * side
    assert len(turns)
    assert (turns >= DRIFT_TURN[0] - 1e-6).all()
    assert (turns <= DRIFT_TURN[1] + 1e-6).all()


def test_in_the_network_boosts_are_faster_and_brakes_are_slower():
    ways = Ways(straight_road(), state=(1, 11, 0), motion=learned_motion())
    boosted = ways.free & (ways.lanes[0] == 0)  # ends a drift that has earned a boost
    assert ways.along[-1, ways.boosts == 0].max() > SPEED * 2.0
    assert ways.along[-1, ways.maneuvers == BRAKE].max() < SPEED * 1.9
    assert boosted.sum() <= 1
