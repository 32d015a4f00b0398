"""Rollout buffers that leave out the steps of idle slots."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from gymnasium import spaces

from stkzoo import ConfigError
from stkzoo.sb3 import ActiveDictRolloutBuffer, ActiveRolloutBuffer

#: Three slots over four steps. Slot 0 races throughout. Slot 1 finishes in the first step and
#: idles until the third. Slot 2 starts a new race in the third step.
STARTS = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 1], [0, 1, 0]])
LAST_DONES = np.array([0, 0, 1])
REAL = {0, 1, 2, 3, 4, 7, 8, 9, 10, 11}  # slot by slot


def filled_buffer(kind, starts=STARTS, last_dones=LAST_DONES):
    """Returns a buffer whose actions are the numbers of its steps, slot by slot."""
    box = spaces.Box(-1, 1, (2,))
    space = spaces.Dict({"x": box}) if kind is ActiveDictRolloutBuffer else box
    num_steps, num_slots = starts.shape
    buffer = kind(num_steps, space, spaces.Discrete(100), "cpu", n_envs=num_slots)
    for step in range(num_steps):
        observation = np.zeros((num_slots, 2), np.float32)
        observation = {"x": observation} if kind is ActiveDictRolloutBuffer else observation
        action = np.arange(num_slots) * num_steps + step
        zeros = torch.zeros(num_slots)
        buffer.add(observation, action, np.ones(num_slots), starts[step], zeros, zeros)
    buffer.compute_returns_and_advantage(torch.zeros(num_slots), last_dones)
    return buffer


def actions_of(batches):
    return [int(action) for batch in batches for action in batch.actions[:, 0]]


@pytest.mark.parametrize("kind", [ActiveRolloutBuffer, ActiveDictRolloutBuffer])
def test_the_buffer_returns_only_real_steps(kind):
    buffer = filled_buffer(kind)
    for _ in range(2):  # two epochs
        actions = actions_of(buffer.get(3))
        assert len(actions) == len(REAL)
        assert set(actions) == REAL


def test_the_buffer_returns_batches_of_the_requested_size():
    buffer = filled_buffer(ActiveRolloutBuffer)
    assert [len(batch.actions) for batch in buffer.get(4)] == [4, 4, 2]
    assert [len(batch.actions) for batch in buffer.get()] == [10]


def test_a_buffer_with_nothing_but_single_steps_is_refused():
    with pytest.raises(ConfigError, match="raise max_cycles"):
        filled_buffer(ActiveRolloutBuffer, np.ones((3, 2)), np.array([1, 1]))


def test_a_buffer_without_idle_steps_returns_all():
    starts = np.array([[1, 1], [0, 0], [0, 0]])
    buffer = filled_buffer(ActiveRolloutBuffer, starts, np.array([1, 0]))
    assert sorted(actions_of(buffer.get(2))) == list(range(6))
