"""Evaluations on the training tracks show overfitting and are not entries."""

import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.plan import plan_differences
from stkzoo.suite import TASKS, About, Entry, EntryRefused, plan_entry, verify_entry
from stkzoo.suite.entry import ENTRY_FILE


@pytest.mark.parametrize(("name", "races"), [("solo-1", 2), ("versus", 60), ("selfplay-5", 120)])
def test_the_training_tracks_have_one_race_of_each_kind(name, races):
    plan = plan_entry(name, "random", split="train")
    assert plan.tracks == TASKS[name].train_tracks
    assert plan.is_on_training_tracks
    assert len(plan.races()) == races
    assert len({race.stratum for race in plan.races()}) == races
    assert {race.form for race in plan.races()} == set(TASKS[name].forms)


def test_an_entry_uses_the_test_tracks():
    plan = plan_entry("versus", "random")
    assert not plan.is_on_training_tracks
    assert plan == plan_entry("versus", "random", split="test")
    assert plan.tracks == TASKS["versus"].test_tracks


def test_an_unknown_split_is_refused(capsys):
    with pytest.raises(ConfigError, match=r"unknown split 'trian'\. Did you mean 'train'"):
        plan_entry("versus", "random", split="trian")
    assert main(["suite", "evaluate", "versus", "random", "--split", "validation"]) == 2
    assert "choose from" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["solo-1", "versus"])
def test_an_evaluation_on_the_training_tracks_is_not_an_entry(name, tmp_path):
    evaluation = Entry(plan_entry(name, "random", split="train"), ())
    (tmp_path / ENTRY_FILE).write_text(evaluation.to_json())
    with pytest.raises(EntryRefused, match="an evaluation on the training tracks; an entry needs"):
        verify_entry(tmp_path)


def test_an_evaluation_on_the_training_tracks_does_not_continue_as_an_entry():
    entry, other = plan_entry("solo-1", "random"), plan_entry("solo-1", "random", split="train")
    assert plan_differences(entry, other)


@pytest.mark.parametrize(
    ("name", "agent", "message"),
    [
        (
            "versus",
            "ai:1",
            r"'ai:1' requires difficulty 1, but the races have difficulty 3; name ai",
        ),
        ("selfplay-5", "ai:3@:Tux", r"'ai:3' requires .* that of selfplay-5 depends on the race"),
    ],
)
def test_an_agent_that_changes_the_difficulty_of_the_races_is_refused(name, agent, message):
    with pytest.raises(ConfigError, match=message):
        plan_entry(name, agent)


@pytest.mark.parametrize(("name", "agent"), [("versus", "ai:3"), ("selfplay-5", "ai")])
def test_the_games_ai_at_the_difficulty_of_the_races_is_an_agent(name, agent):
    assert plan_entry(name, agent).agent.source == agent


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"kart_steps": -1}, "kart_steps is -1, expected a whole number from 0"),
        ({"kart_steps": 1.5}, "kart_steps is 1.5"),
        ({"authors": "x" * 2001}, "authors is 'xxx.*, expected text of at most 2,000 char"),
        ({"description": None}, "description is None, expected text"),
    ],
)
def test_invalid_facts_about_an_entry_are_refused_before_its_races(about, message):
    with pytest.raises(ConfigError, match=message):
        About(**about)
