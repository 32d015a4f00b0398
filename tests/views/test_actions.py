"""Checks of actions from untrusted code."""

import tracemalloc

import numpy as np
import pytest
from gymnasium import spaces

from stkzoo.errors import ActionError
from stkzoo.views.actions import read_action

STEER = spaces.Dict({"steer": spaces.Box(-1, 1, (1,), np.float32)})


@pytest.mark.slow
@pytest.mark.parametrize(
    "steer",
    [
        ["x" * 1_000_000, *["x"] * 1000],  # NumPy would create 1001 strings of 4 MB each
        [["x" * 1_000_000], ["x"] * 1000],
        "x" * 1_000_000,
        np.zeros([7] * 8, np.int8),
        [np.zeros([6] * 8, np.int8)],
        [np.zeros(0)] * 100_000,
    ],
    ids=["texts", "nested texts", "text", "many axes", "many axes in a list", "empty arrays"],
)
def test_refusing_an_action_costs_little(steer):
    tracemalloc.start()
    with pytest.raises(ActionError, match="expected a number from -1") as caught:
        read_action(STEER, {"steer": steer}, "kart_0")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20
    assert len(str(caught.value)) < 500


def test_only_a_few_unknown_keys_are_named():
    action = {"x" * 1_000_000 + str(number): 0 for number in range(10)}
    with pytest.raises(ActionError, match="unknown keys xxx") as caught:
        read_action(STEER, action, "kart_0")
    assert len(str(caught.value)) < 1000
