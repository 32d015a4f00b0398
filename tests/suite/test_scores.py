"""Normalized scores are relative to the weakest and the strongest baseline."""

import json
from dataclasses import asdict

import pytest

from stkzoo.errors import ConfigError
from stkzoo.evaluation import Estimate
from stkzoo.suite import SUITE, TASKS, Baselines, load_baselines, normalized
from stkzoo.suite.population import population_digests


def baselines(task, values, digest=None, suite=SUITE, population=None):
    scores = {task: {str(n): Estimate(value, None, None) for n, value in enumerate(values)}}
    met = population_digests() if population is None else population
    return Baselines(suite, {task: digest or TASKS[task].digest}, met, scores)


def test_a_larger_share_of_beaten_karts_is_better():
    found = baselines("versus", [0.4, 0.2, 0.8])
    assert normalized("versus", 0.2, found) == 0.0
    assert normalized("versus", 0.8, found) == 1.0
    assert normalized("versus", 0.5, found) == pytest.approx(0.5)
    assert normalized("versus", 0.95, found) == pytest.approx(1.25)


def test_a_smaller_time_ratio_is_better():
    found = baselines("solo-1", [0.9, 0.8, 1.4])
    assert normalized("solo-1", 1.4, found) == 0.0
    assert normalized("solo-1", 0.8, found) == 1.0
    assert normalized("solo-1", 1.1, found) == pytest.approx(0.5)
    assert normalized("solo-1", 0.74, found) == pytest.approx(1.1)


@pytest.mark.parametrize("changes", [{"digest": "0" * 64}, {"suite": "stkzoo-suite-2"}])
def test_scores_of_another_definition_are_not_baselines(changes):
    with pytest.raises(ConfigError, match="solo-1 has no baselines yet"):
        normalized("solo-1", 0.9, baselines("solo-1", [0.9, 0.8], **changes))
    with pytest.raises(ConfigError, match="versus has no baselines yet"):
        normalized("versus", 0.9, baselines("solo-1", [0.9, 0.8]))


def test_scores_against_another_population_are_not_baselines():
    other = {**population_digests(), "heuristic": "0" * 16}
    assert not baselines("team-2v2", [0.1, 0.9], population=other).has("team-2v2")
    assert baselines("team-2v2", [0.1, 0.9]).has("team-2v2")
    assert baselines("versus", [0.1, 0.9], population=other).has("versus")


def test_the_shipped_baselines_match_the_tasks():
    found = load_baselines()
    for task, scores in found.scores.items():
        weakest, strongest = found.ends(task)
        assert weakest != strongest
        values = [normalized(task, score.value) for score in scores.values()]
        assert (min(values), max(values)) == (0.0, 1.0)
        assert len(scores) == 6
    assert json.dumps(asdict(found))
