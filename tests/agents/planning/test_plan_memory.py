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


@pytest.mark.parametrize("first", [-1, 4, 2**40])
def test_write_memory_does_not_write_beyond_a_row(first):
    rules, memory, out, _ = write_arguments(0)
    with pytest.raises(ValueError, match="too short"):
        _planning.write_memory(rules, memory, out, first)


@pytest.mark.parametrize(("place", "size"), [(0, 3), (1, 7), (2, 5), (3, 1)])
def test_age_memory_refuses_arrays_that_do_not_fit(place, size):
    arguments = list(age_arguments(0, count=2))
    arguments[place] = np.zeros(size, arguments[place].dtype)
    with pytest.raises(ValueError, match=r"fit|must be"):
        _planning.age_memory(*arguments)
