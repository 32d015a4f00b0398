"""Evaluation of plans in the extension, compared with the oracle."""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.motion import DRIFT_TURN, RELEASE_STEPS, learned_motion
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.plans import BRAKE, LONGEST_DRIFT, plan_table
from stkzoo.agents.planning.road import LINE_MARKS, MARK_COUNT, MARK_SPACING, headings_of
from stkzoo.agents.planning.worth import plan_rules
from tests.oracle import plan_weigher
from tests.oracle.plan_viewer import table_rows, write_road
from tests.oracle.road_ahead import RoadAhead

RADIUS, LOCK, SPEED, REACH = 60.0, 1.45, 25.0, 12.0
RULES = DriverParameters()
#: Drift side, drift steps and release steps of all states in the table.
STATES = np.array(
    [
        *((0, 0, left) for left in range(RELEASE_STEPS + 1)),
        *((side, steps, 0) for side in (-1, 1) for steps in range(LONGEST_DRIFT + 1)),
    ]
)


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
        self.along, self.across, _, _, turns = drive(
            table, plan_rules(RULES).costs, motion, rows, karts, marks, columns
        )
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
@pytest.mark.parametrize("weigh", [_planning.weigh_plans, plan_weigher.weigh_plans])
@pytest.mark.parametrize("side", [-1, 1])
def test_the_cost_begins_at_the_edge_of_that_side(side, weigh, motion):
    narrow, wide = 2.0, 6.0
    table, rules = plan_table(RULES.lane_changes), plan_rules(RULES).costs
    marks, none = np.zeros((1, 4, MARK_COUNT), np.float32), np.zeros((1, 0, 4))
    marks[0, 1:3] = [[narrow], [wide]] if side > 0 else [[wide], [narrow]]
    table = table._replace(lanes=np.zeros_like(table.lanes))  # lets all plans steer to the middle

    def danger(offset):
        """Returns the cost at an offset toward the wide side."""
        kart = [SPEED, LOCK, REACH, 0, 0, side * offset, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
        out = np.empty((3, 1, 4), np.float32)
        karts, rows = np.array([kart], np.float32), np.zeros(1, np.intp)
        weigh(table, rules, motion, rows, karts, marks, none, np.zeros((1, 0, 5)), out)
        return out[2, 0, 0]

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


def random_arguments(seed, count=9, motion=()):
    """Returns arguments for karts in all states, between items and rivals, on winding roads."""
    chance = np.random.default_rng(seed)
    rules = plan_rules(RULES).costs

    def draw(*shape, low=-1.0, high=1.0):
        return chance.uniform(low, high, shape)

    table = plan_table(RULES.lane_changes)
    karts = np.concatenate(
        [
            draw(count, 3, low=[5.0, 0.5, 6.0], high=[30.0, 2.0, 14.0]),
            draw(count, 4, low=[-1, -0.8, -6, -0.8], high=[1, 0.8, 6, 0.8]),
            draw(count, 2, low=0, high=45),
            chance.integers(0, 2, (count, 2)),
            draw(count, 2, low=[-2, -0.2], high=[2, 0.2]),
            np.zeros((count, 3)),
        ],
        axis=1,
    ).astype(np.float32)
    road = draw(count, 4, 36, low=[[-4], [0.3], [0.3], [-0.05]], high=[[4], [5], [5], [0.05]])
    items = draw(count, 8, 4, low=[0, -5, -15, 0.8], high=[60, 5, 20, 1.0])
    items[:, 5:, 2] = 0
    rivals = draw(count, 4, 5, low=[-1, -5, -4, -15, -3], high=[1, 30, 4, 3, 3])
    rivals[..., 0] = rivals[..., 0] > 0
    rivals[..., 2:] = rivals[..., 2:].astype(np.float32)
    rows = chance.integers(0, len(table.lanes), count)
    side, steps, release = STATES[rows % len(STATES)].T
    karts[:, 13:] = np.stack([side, steps, release], axis=1)
    rows = table_rows(side, steps, release, (RELEASE_STEPS, LONGEST_DRIFT))
    return table, rules, motion, rows, karts, road.astype(np.float32), items, rivals


@pytest.mark.parametrize("seed", range(20))
def test_weigh_plans_matches_the_oracle(seed):
    arguments = random_arguments(seed)
    ours, theirs = weighed_by_both(arguments)
    np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("seed", range(20))
def test_weigh_plans_with_the_network_matches_the_oracle(seed):
    ours, theirs = weighed_by_both(random_arguments(seed, motion=learned_motion()))
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-4, atol=1e-2)
    # if two plans have nearly the same value, either may be the best
    assert np.isclose(ours[1:], theirs[1:], rtol=1e-3, atol=1e-2).mean() > 0.95


def weighed_by_both(arguments):
    """Returns the results of the kernel and of the reference implementation."""
    ours, theirs = (np.empty((3, len(arguments[3]), 4), np.float32) for _ in range(2))
    _planning.weigh_plans(*arguments, ours)
    plan_weigher.weigh_plans(*arguments, theirs)
    return ours, theirs


@pytest.mark.parametrize("part", range(1, 7))
def test_nan_in_the_network_reaches_the_worth_of_plans(part):
    motion = tuple(array.copy() for array in learned_motion())
    motion[part].flat[0] = np.nan
    with np.errstate(invalid="ignore"):
        ours, theirs = weighed_by_both(random_arguments(0, motion=motion))
    assert np.isnan(ours[0]).any()
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))


@pytest.mark.parametrize("span", [np.nan, -1.0, np.inf, 1e9])
def test_spans_that_would_never_end_are_refused(span):
    table, *arguments = random_arguments(0, count=1, motion=learned_motion())
    spans = table.spans.copy()
    spans[-1] = span
    with pytest.raises(ValueError, match="at most 100 s"):
        _planning.weigh_plans(
            table._replace(spans=spans), *arguments, np.empty((3, 1, 4), np.float32)
        )


@pytest.mark.parametrize("motion", [(), learned_motion()], ids=["arcs", "network"])
def test_results_do_not_depend_on_the_batch(motion):
    table, rules, _, *of_karts = random_arguments(0)
    together = np.empty((3, len(of_karts[0]), 4), np.float32)
    _planning.weigh_plans(table, rules, motion, *of_karts, together)
    for kart in range(len(of_karts[0])):
        alone = np.empty((3, 1, 4), np.float32)
        _planning.weigh_plans(
            table, rules, motion, *(array[kart : kart + 1] for array in of_karts), alone
        )
        assert (alone[:, 0] == together[:, kart]).all()
