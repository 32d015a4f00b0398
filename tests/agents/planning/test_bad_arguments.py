"""The extension accepts or refuses bad arguments and never accesses memory outside its arrays.

``make sanitize`` runs these tests with an extension that stops the program at such an access.
"""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.motion import learned_motion
from tests.agents.planning.test_plan_memory import age_arguments, write_arguments
from tests.agents.planning.test_plan_viewer import present_arguments, scene_arguments
from tests.agents.planning.test_plan_weigher import random_arguments
from tests.support.bad_arguments import check_bad_calls, check_lists_are_refused


def weigh_arguments(motion):
    return *random_arguments(0, count=2, motion=motion), np.empty((3, 2, 4), np.float32)


CASES = {
    "age_memory": [age_arguments(0, count=2)],
    "present_plans": [present_arguments(0, count=2)],
    "survey_road": [scene_arguments(0, count=2)],
    "weigh_plans": [weigh_arguments(()), weigh_arguments(learned_motion())],
    "write_memory": [write_arguments(0, count=2)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_bad_arguments_are_accepted_or_refused(name):
    check_bad_calls(getattr(_planning, name), [(args, {}, None, ()) for args in CASES[name]])


@pytest.mark.parametrize("name", ["present_plans", "survey_road", "weigh_plans"])
def test_arrays_in_a_list_are_refused(name):
    for args in CASES[name]:
        assert check_lists_are_refused(getattr(_planning, name), args)


def test_a_plan_for_an_item_out_of_range_ignores_it():
    table, *arguments = random_arguments(0, count=1)
    lost, none = (table._replace(items=np.full_like(table.items, number)) for number in (10**6, -1))
    out = np.empty((2, 3, 1, 4), np.float32)
    _planning.weigh_plans(lost, *arguments, out[0])
    _planning.weigh_plans(none, *arguments, out[1])
    assert (out[0] == out[1]).all()
