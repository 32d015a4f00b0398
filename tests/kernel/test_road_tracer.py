"""Road lines ahead of karts in the kernel, compared with the oracle."""

import numpy as np
import pytest

from stkzoo import kernel
from stkzoo.wrappers.racing.features import LOOKS
from stkzoo.wrappers.racing.surroundings import _RULES, NUM_POINTS
from tests.oracle import road_tracer


def segments(chance, count):
    """Returns segments ahead of a kart, some with gaps, with a fork, or of length 0."""
    steps = chance.normal([0, 0, 8], [3, 1, 5], (count, 3))
    steps[chance.random(count) < 0.1] = 0
    ends = np.cumsum(steps, axis=0)
    starts = ends - steps
    if chance.random() < 0.5:
        side = chance.random(count) < 0.4
        starts[side] += 6.0
        ends[side] += 6.0
    if chance.random() < 0.3:
        starts[count // 2 :] += 60.0
        ends[count // 2 :] += 60.0
    widths = chance.uniform(3, 20, (count, 1))
    return tuple(array.astype(np.float32) for array in (starts, ends, widths))


def roads_of(seed, counts=(1, 2, 5, 30, 96, 120, 0)):
    chance = np.random.default_rng(seed)
    arrays = [np.full((len(counts), max(counts), size), np.nan, "f4") for size in (3, 3, 1)]
    for number, count in enumerate(counts):
        for array, part in zip(arrays, segments(chance, count), strict=True):
            array[number, :count] = part
    return *arrays[:2], arrays[2][..., 0], np.array(counts)


def traced(trace, roads):
    count = len(roads[0])
    lines, points = (np.empty((count, size, 4), "f4") for size in (NUM_POINTS, len(LOOKS)))
    trace(*roads, _RULES, lines, LOOKS, points)
    return lines, points


@pytest.mark.parametrize("seed", range(12))
def test_trace_roads_matches_the_oracle(seed):
    roads = roads_of(seed)
    ours, theirs = traced(kernel.trace_roads, roads), traced(road_tracer.trace_roads, roads)
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own, other, rtol=2e-6, atol=2e-5)


@pytest.mark.parametrize("counts", [[121], [-1], [1, 1]])
def test_numbers_of_segments_that_do_not_fit_are_refused(counts):
    roads = *roads_of(0, (120,))[:3], np.array(counts)
    with pytest.raises(ValueError, match="do not fit"):
        traced(kernel.trace_roads, roads)
