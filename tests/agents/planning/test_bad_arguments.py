"""The extension accepts or refuses bad arguments and never accesses memory outside its arrays.

``make sanitize`` runs these tests with an extension that stops the program at such an access.
"""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.motion import learned_motion
from tests.agents.planning.test_plan_memory import age_arguments, write_arguments
from tests.agents.planning.test_plan_viewer import scene_arguments
from tests.support.bad_arguments import check_bad_calls, check_lists_are_refused

CASES = {
    "age_memory": [age_arguments(0, count=2)],
    "compute_layer": [
        (*(np.ones(shape, np.float32) for shape in ((5, 16), 16)), activation, rows, outputs)
        for activation in range(3)
        for rows, outputs in [(np.ones((5, 6), np.float32), np.ones((5, 16), np.float32))]
    ],
    "plan_karts": [
        scene_arguments(0, count=2, motion=motion, has_line=has_line, is_watching=has_line)
        for motion, has_line in (((), True), (learned_motion(), False))
    ],
    "write_memory": [write_arguments(0, count=2)],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_bad_arguments_are_accepted_or_refused(name):
    check_bad_calls(getattr(_planning, name), [(args, {}, None, ()) for args in CASES[name]])


def test_arrays_in_a_list_are_refused():
    for args in CASES["plan_karts"]:
        assert check_lists_are_refused(_planning.plan_karts, args)
