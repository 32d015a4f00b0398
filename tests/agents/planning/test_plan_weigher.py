"""The cost of plans beyond the edges of the road."""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.memory import LINE_MARKS
from stkzoo.agents.planning.motion import learned_motion
from stkzoo.agents.planning.parameters import DriverParameters, rule_numbers
from tests.agents.planning.test_plan_viewer import planned, scene_arguments
from tests.oracle import plan_viewer

SPEED = 25.0  # [m/s]


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
