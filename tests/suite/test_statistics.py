"""Statistics over runs: known values and resampling."""

import numpy as np
import pytest

from stkzoo.evaluation import Estimate
from stkzoo.suite.report.statistics import (
    ScoreTable,
    estimate,
    estimate_t,
    gap,
    improvement,
    interquartile_mean,
    mean,
    runs_needed,
)

#: Three runs and two runs in four columns; the expected values below are those of rliable 1.2.0.
SCORES = np.array([[0.1, 0.5, 0.9, 0.3], [0.2, 0.5, 0.8, 0.7], [0.4, 0.6, 1.1, 0.2]])
OTHERS = np.array([[0.2, 0.5, 0.7, 0.3], [0.3, 0.4, 0.8, 0.1]])


def table(scores, runs="runs", tracks="tracks", directions=1):
    return ScoreTable(np.asarray(scores, float), runs, tracks, directions)


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end():
    assert interquartile_mean(SCORES) == pytest.approx(0.5)
    assert interquartile_mean(np.array([[0.0, 1.0, 3.0, 1000.0]])) == pytest.approx(2.0)


def test_the_probability_of_improvement_counts_ties_half():
    assert improvement(SCORES, OTHERS) == pytest.approx(0.7291666666666666)
    assert improvement(SCORES, SCORES) == pytest.approx(0.5)


def test_one_run_has_no_interval():
    assert estimate(mean, table(SCORES[:1])) == Estimate(pytest.approx(0.45), None, None)
    assert estimate(improvement, table(SCORES, "a"), table(SCORES[:1], "b")).low is None


def test_equal_scores_have_no_interval():
    assert estimate(mean, table(np.ones((3, 12)))) == Estimate(1.0, None, None)


def test_runs_are_resampled_as_a_whole():
    """If runs differ equally in all columns, the interval has the spread of the runs."""
    skill = np.array([[0.0], [0.5], [1.0]])
    found = estimate(mean, table(skill + np.zeros(12)))
    assert (found.low, found.high) == (0.0, 1.0)


def test_columns_are_resampled_as_a_whole():
    """If tracks differ equally for all runs, the interval has the spread of the tracks."""
    found = estimate(mean, table(np.zeros((10, 1)) + np.array([0.0, 0.0, 1.0, 1.0])))
    assert (found.low, found.high) == (0.0, 1.0)


def test_both_directions_of_a_track_are_resampled_together():
    """A draw has one of the two tracks, in both directions."""
    opposite = np.zeros((3, 1)) + np.array([0.0, 1.0, 1.0, 0.0])
    assert estimate(mean, table(opposite, directions=2)) == Estimate(0.5, None, None)
    equal = np.zeros((3, 1)) + np.array([0.0, 0.0, 1.0, 1.0])
    assert estimate(mean, table(equal, directions=2)).interval == (0.0, 1.0)


def test_effects_that_tables_share_cancel_out():
    difficulty = np.arange(12.0)
    noise = np.random.default_rng(1).normal(0, 0.01, (2, 3, 12))
    easy, hard = table(noise[0] + 1 + difficulty, "a"), table(noise[1] + difficulty, "b")
    assert estimate(improvement, easy, hard) == Estimate(1.0, None, None)
    found = estimate(gap, table(easy.scores), table(hard.scores))
    assert found.high - found.low < 0.1
    assert estimate(mean, easy).high - estimate(mean, easy).low > 1


def test_simulated_intervals_contain_the_true_mean():
    """Most 95% intervals from four runs and twelve tracks contain the true mean."""
    random, hits = np.random.default_rng(0), 0
    for _ in range(100):
        tracks, runs = random.normal(0, 0.15, 12), random.normal(0, 0.05, (4, 1))
        found = estimate(mean, table(tracks + runs + random.normal(0, 0.08, (4, 12))))
        hits += found.low <= 0 <= found.high
    assert 85 <= hits <= 100


@pytest.mark.parametrize(
    ("deviation", "difference", "runs"),
    [(1, 0.5, 64), (1, 0.8, 26), (1, 1, 17), (1, 2, 6), (20, 1, 6281)],
)
def test_the_number_of_runs_for_80_percent_power_is_that_of_the_t_test(deviation, difference, runs):
    """The expected numbers are those of G*Power 3.1."""
    assert runs_needed(deviation, difference) == runs


def test_an_interval_of_student_needs_two_different_values():
    assert estimate_t([1.0]) == estimate_t([1.0, 1.0]) == Estimate(1.0, None, None)
    assert estimate_t([0.0, 1.0, 2.0]).interval == pytest.approx((1 - 2.4841, 1 + 2.4841), abs=1e-4)
