"""The memory of drivers in the extension, compared with the oracle."""

import numpy as np
import pytest

from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.memory import MEMORY_SIZE, DriverMemory, PlanMemory
from stkzoo.agents.planning.parameters import DriverParameters
from tests.oracle import plan_memory


def memory_of(chance, count):
    memory = chance.integers(0, 5, (len(PlanMemory._fields), count)).astype(np.float32)
    names = PlanMemory._fields
    memory[names.index("drift_side")] = chance.integers(-1, 2, count)
    memory[names.index("free_steps")] = chance.integers(0, 80, count)
    memory[names.index("drift_steps")] = chance.integers(0, 70, count)
    memory[names.index("speed")] = chance.normal(12, 8, count)
    memory[names.index("gain")] = chance.normal(0, 8, count)
    return memory


def age_arguments(seed, count=200):
    chance = np.random.default_rng(seed)
    rules = DriverMemory(1, DriverParameters())._numbers
    speed = chance.choice([0.0, 1.0, 4.0, -3.0, 20.0], count) + chance.normal(0, 0.5, count)
    skeed = chance.choice([1.0, 1.4], count)
    return rules, memory_of(chance, count), speed.astype(np.float32), skeed.astype(np.float32)


def write_arguments(seed, count=200):
    rules, memory, *_ = age_arguments(seed, count)
    return rules, memory, np.zeros((count, MEMORY_SIZE + 3), np.float32), 2


@pytest.mark.parametrize("seed", range(5))
def test_age_memory_matches_the_oracle(seed):
    rules, memory, *rest = age_arguments(seed)
    ours, theirs = memory.copy(), memory.copy()
    _planning.age_memory(rules, ours, *rest)
    plan_memory.age_memory(rules, theirs, *rest)
    np.testing.assert_array_equal(ours, theirs)
    assert (ours != memory).any(axis=1).sum() > 15


@pytest.mark.parametrize("seed", range(5))
def test_write_memory_matches_the_oracle(seed):
    rules, memory, out, first = write_arguments(seed)
    ours, theirs = out.copy(), out.copy()
    _planning.write_memory(rules, memory, ours, first)
    plan_memory.write_memory(rules, memory, theirs, first)
    np.testing.assert_array_equal(ours, theirs)
    assert not ours[:, [0, 1, -1]].any()
