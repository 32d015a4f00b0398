"""Means with intervals over clusters."""

import numpy as np
import pytest

from stkzoo.evaluation.statistics import estimate_clustered, student_t


def clusters_of(values):
    """Returns the totals and counts of values ``(C, n)``, with a cluster in each row."""
    return values.sum(axis=1), np.full(len(values), float(values.shape[1]))


def test_the_mean_is_over_values_not_over_clusters():
    found = estimate_clustered(np.array([2.0, 9.0, 4.0, 5.0]), np.array([1.0, 3.0, 2.0, 4.0]))
    assert found.value == 2.0
    assert found.low < 2.0 < found.high


def test_the_interval_contains_the_true_mean_over_tracks_at_the_stated_rate():
    chance = np.random.default_rng(2)
    hits = 0
    for _ in range(300):
        of_track = chance.normal(1.0, 0.04, (12, 1))
        found = estimate_clustered(*clusters_of(chance.normal(of_track, 0.03, (12, 5))))
        hits += found.low <= 1.0 <= found.high
    assert 273 <= hits <= 296  # 91 to 98.7%


@pytest.mark.parametrize(
    ("freedom", "quantile"), [(3, 3.1824463), (4, 2.7764451), (5, 2.5705818), (20, 2.0859634)]
)
def test_few_clusters_give_the_tails_of_students_t(freedom, quantile):
    assert student_t(freedom) == pytest.approx(quantile, rel=1e-7)


def test_clusters_without_values_do_not_count():
    totals, counts = clusters_of(np.random.default_rng(4).normal(size=(6, 2)))
    padded = np.append(totals, 0.0), np.append(counts, 0.0)
    assert estimate_clustered(*padded) == estimate_clustered(totals, counts)
    assert estimate_clustered(np.zeros(2), np.zeros(2)) is None


@pytest.mark.parametrize("means", [[1.0, 2.0, 3.0], [1.0] * 8])
def test_few_or_equal_clusters_give_no_interval(means):
    found = estimate_clustered(np.array(means), np.ones(len(means)))
    assert (found.low, found.high) == (None, None)
