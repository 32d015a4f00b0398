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
    return tuple(zip(*(segments(chance, count) for count in counts), strict=True))


def traced(trace, roads):
    count = len(roads[0])
    lines, points = (np.empty((count, size, 4), "f4") for size in (NUM_POINTS, len(LOOKS)))
    trace(*roads, 96, _RULES, lines, LOOKS, points)
    return lines, points


@pytest.mark.parametrize("seed", range(12))
def test_trace_roads_matches_the_oracle(seed):
    roads = roads_of(seed)
    ours, theirs = traced(kernel.trace_roads, roads), traced(road_tracer.trace_roads, roads)
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own, other, rtol=2e-6, atol=2e-5)


@pytest.mark.parametrize("form", [tuple, list, np.float64])
def test_segments_can_be_arrays_or_sequences(form):
    roads = roads_of(0)
    others = tuple(tuple(form(array) for array in part) for part in roads)
    for own, other in zip(
        traced(kernel.trace_roads, roads), traced(kernel.trace_roads, others), strict=True
    ):
        np.testing.assert_array_equal(own, other)


def test_vectors_are_stacked_and_padded():
    rows = (np.ones((2, 3), "f4"), [np.full(3, 2.0)], ())
    ours, theirs = np.empty((3, 2, 3), np.float32), np.empty((3, 2, 3), np.float32)
    kernel.stack_vectors(rows, np.inf, ours)
    road_tracer.stack_vectors(rows, np.inf, theirs)
    np.testing.assert_array_equal(ours, theirs)
    assert ours[:, :, 0].tolist() == [[1, 1], [2, np.inf], [np.inf, np.inf]]
    with pytest.raises(ValueError, match="same number of vectors"):
        kernel.stack_vectors(rows, np.inf, np.empty((2, 2, 3), np.float32))
