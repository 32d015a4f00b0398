"""Normalized scores: *random* has 0 and *zenith* has 1."""

import json
from dataclasses import asdict

import pytest

from stkzoo.evaluation import Estimate
from stkzoo.suite import SUITE, TASKS, Baselines, load_baselines, normalized, scores
from stkzoo.suite.population import population_digests
from stkzoo.suite.scores import ONE, ZERO, scale_ends


def baselines(task, values, digest=None, suite=SUITE, population=None):
    names = (ZERO, ONE, "ai")
    ends = {name: Estimate(v, None, None) for name, v in zip(names, values, strict=False)}
    met = population_digests() if population is None else population
    return Baselines(suite, {task: digest or TASKS[task].digest}, met, {task: ends})


@pytest.fixture
def measure(monkeypatch):
    """Returns a function that replaces the shipped baselines by made-up ones."""

    def replace(*arguments, **changes):
        made_up = baselines(*arguments, **changes)
        monkeypatch.setattr("stkzoo.suite.scores.load_baselines", lambda: made_up)

    return replace


def test_a_larger_share_of_beaten_karts_is_better(measure):
    measure("versus", [0.2, 0.8, 0.9])
    found = [normalized("versus", score) for score in (0.2, 0.8, 0.5, 0.95)]
    assert found == pytest.approx([0.0, 1.0, 0.5, 1.25])


def test_a_smaller_time_ratio_is_better(measure):
    measure("solo-general", [1.4, 0.8, 0.7])
    found = [normalized("solo-general", score) for score in (1.4, 0.8, 1.1, 0.74)]
    assert found == pytest.approx([0.0, 1.0, 0.5, 1.1])


@pytest.mark.parametrize("changes", [{"digest": "0" * 64}, {"suite": "stkzoo-suite-2"}])
def test_scores_of_another_definition_are_not_baselines(measure, changes):
    measure("solo-general", [0.9, 0.8], **changes)
    assert normalized("solo-general", 0.9) is None
    assert normalized("versus", 0.9) is None


def test_scores_against_another_population_are_not_baselines():
    other = {**population_digests(), "heuristic": "0" * 16}
    assert not baselines("team-2v2", [0.1, 0.9], population=other).has("team-2v2")
    assert baselines("team-2v2", [0.1, 0.9]).has("team-2v2")
    assert baselines("versus", [0.1, 0.9], population=other).has("versus")


@pytest.mark.parametrize("name", [ZERO, ONE])
def test_both_ends_of_the_scale_are_needed(measure, name):
    measure("versus", [0.2, 0.8])
    del scores.load_baselines().scores["versus"][name]
    assert normalized("versus", 0.5) is None
    assert scale_ends("versus") == (0.0, 1.0)


def test_the_shipped_scores_give_the_ends_of_the_scale():
    shipped = load_baselines()
    for task in TASKS:
        assert shipped.has(task)
        ends = [normalized(task, shipped.scores[task][name].value) for name in (ZERO, ONE)]
        assert ends == [0.0, 1.0]
    assert json.dumps(asdict(shipped))
