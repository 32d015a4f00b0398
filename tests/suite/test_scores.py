"""Normalized scores are relative to the weakest and the strongest baseline."""

import json
from dataclasses import asdict

import pytest

from stkzoo.evaluation import Estimate
from stkzoo.suite import SUITE, TASKS, Baselines, load_baselines, normalized
from stkzoo.suite.population import population_digests
from stkzoo.suite.scores import scale_ends


def baselines(task, values, digest=None, suite=SUITE, population=None):
    scores = {task: {str(n): Estimate(value, None, None) for n, value in enumerate(values)}}
    met = population_digests() if population is None else population
    return Baselines(suite, {task: digest or TASKS[task].digest}, met, scores)


@pytest.fixture
def measure(monkeypatch):
    """Returns a function that replaces the shipped baselines by made-up ones."""

    def replace(*arguments, **changes):
        made_up = baselines(*arguments, **changes)
        monkeypatch.setattr("stkzoo.suite.scores.load_baselines", lambda: made_up)

    return replace


def test_a_larger_share_of_beaten_karts_is_better(measure):
    measure("versus", [0.4, 0.2, 0.8])
    found = [normalized("versus", score) for score in (0.2, 0.8, 0.5, 0.95)]
    assert found == pytest.approx([0.0, 1.0, 0.5, 1.25])


def test_a_smaller_time_ratio_is_better(measure):
    measure("solo-1", [0.9, 0.8, 1.4])
    found = [normalized("solo-1", score) for score in (1.4, 0.8, 1.1, 0.74)]
    assert found == pytest.approx([0.0, 1.0, 0.5, 1.1])


@pytest.mark.parametrize("changes", [{"digest": "0" * 64}, {"suite": "stkzoo-suite-2"}])
def test_scores_of_another_definition_are_not_baselines(measure, changes):
    measure("solo-1", [0.9, 0.8], **changes)
    assert normalized("solo-1", 0.9) is None
    assert normalized("versus", 0.9) is None


def test_scores_against_another_population_are_not_baselines():
    other = {**population_digests(), "heuristic": "0" * 16}
    assert not baselines("team-2v2", [0.1, 0.9], population=other).has("team-2v2")
    assert baselines("team-2v2", [0.1, 0.9]).has("team-2v2")
    assert baselines("versus", [0.1, 0.9], population=other).has("versus")


def test_the_shipped_baselines_match_the_tasks():
    found = load_baselines()
    for task, scores in found.scores.items():
        weakest, strongest = scale_ends(task)
        assert weakest != strongest
        values = [normalized(task, score.value) for score in scores.values()]
        assert (min(values), max(values)) == (0.0, 1.0)
        assert len(scores) == 6
    assert json.dumps(asdict(found))
