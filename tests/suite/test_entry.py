"""The races of entries, and what entries say about their agents."""

import json
from contextlib import ExitStack

import pytest

from stkzoo.cli import main
from stkzoo.drivers import driver_names, find_driver
from stkzoo.errors import ConfigError
from stkzoo.suite import TASKS, About, Entry, EntryRefused, plan_entry, verify_entry
from stkzoo.suite.about import shipped_class
from stkzoo.suite.entry import ENTRY_FILE


@pytest.mark.parametrize(
    ("name", "races"), [("solo-general", 30), ("versus", 60), ("selfplay-5", 120)]
)
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


@pytest.mark.parametrize("name", ["solo-general", "versus"])
def test_an_evaluation_on_the_training_tracks_is_not_an_entry(name, tmp_path):
    evaluation = Entry(plan_entry(name, "random", split="train"), ())
    (tmp_path / ENTRY_FILE).write_text(evaluation.to_json())
    with pytest.raises(EntryRefused, match="an evaluation on the training tracks; an entry needs"):
        verify_entry(tmp_path)


def test_an_evaluation_on_the_training_tracks_does_not_continue_as_an_entry():
    entry, other = (
        plan_entry("solo-general", "random"),
        plan_entry("solo-general", "random", split="train"),
    )
    assert entry.differences(other)


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
        ({"training_seed": -1}, "training_seed is -1"),
        ({"agent_class": "lerned"}, "unknown class 'lerned'. Did you mean 'learned'"),
        ({"variant": "x" * 41}, "variant is 'xxx.*, expected text of at most 40 char"),
        ({"authors": "x" * 2001}, "authors is 'xxx.*, expected text of at most 2,000 char"),
        ({"description": None}, "description is None, expected text"),
    ],
)
def test_invalid_facts_about_an_entry_are_refused_before_its_races(about, message):
    with pytest.raises(ConfigError, match=message):
        About(**about)


# ------------------------------------------------------------------ classes


def agent_folder(tmp_path, card=None):
    folder = tmp_path / "nova"
    folder.mkdir()
    (folder / "pystk_actor.py").write_text("def get_actor(*_):\n    return None\n")
    if card is not None:
        (folder / "card.json").write_text(json.dumps(card))
    return str(folder)


@pytest.mark.parametrize("name", driver_names())
def test_the_class_of_a_driver_of_stkzoo_is_filled_in_and_cannot_be_contradicted(name):
    with ExitStack() as resources:
        load = find_driver(name).load
        sees_copies = load is not None and load(resources).make_race_actor is not None
    expected = "search" if sees_copies else "scripted"
    expected = "learned" if name.startswith("pretrained:") else expected
    assert plan_entry("solo-general", name).about.agent_class == expected == shipped_class(name)
    other = "scripted" if expected == "learned" else "learned"
    with pytest.raises(ConfigError, match=f"comes with stkzoo and its class is {expected}, not"):
        plan_entry("solo-general", name, about=About(agent_class=other))


def test_an_agent_from_files_names_its_class(tmp_path, capsys):
    agent = agent_folder(tmp_path)
    assert main(["suite", "evaluate", "solo-general", agent]) == 2
    assert "'nova' has no class; choose one of learned, scripted" in capsys.readouterr().err
    about = About(agent_class="search", demonstrations=True)
    assert plan_entry("solo-general", agent, about=about).about == about


def test_the_card_of_a_trained_agent_says_how_it_was_trained(tmp_path):
    arguments = {"algorithm": "ippo", "seed": 3, "gamma": 0.99}
    run = {"kart_steps": 2_000_000, "history": [{"from": 0, "arguments": arguments}]}
    agent = agent_folder(tmp_path, {"runs": [run], "variant": "argmax"})
    facts = {"agent_class": "learned", "kart_steps": 2_000_000, "training_seed": 3}
    for changes in ({"authors": "Ada"}, {"algorithm": "ippo, tuned"}):
        about = plan_entry("solo-general", agent, about=About(**changes)).about
        assert about == About(**{**facts, "algorithm": "ippo", "variant": "argmax", **changes})


@pytest.mark.parametrize("card", [{"runs": 3}, {"runs": []}, ["other"], None])
def test_a_card_of_another_program_says_nothing(tmp_path, card):
    with pytest.raises(ConfigError, match="'nova' has no class"):
        plan_entry("solo-general", agent_folder(tmp_path, card))


@pytest.mark.parametrize("label", ["heuristic", "Heur\u200bistic", "pretrained:zenith", "ai:3"])
def test_an_agent_from_files_cannot_have_the_name_of_a_driver_of_stkzoo(label, tmp_path):
    agent = agent_folder(tmp_path)
    with pytest.raises(ConfigError, match=f"is called .*{label[-4:]}', like a driver of stkzoo"):
        plan_entry("solo-general", f"{agent}@:{label}", about=About(agent_class="learned"))


# ------------------------------------------------------------------ fresh races


def test_a_text_draws_other_races_with_other_rivals():
    standard, one, same, other = (
        plan_entry("selfplay-5", "random", fresh=text) for text in ("", "a", "a", "b")
    )
    assert one == same
    assert standard.differences(one)
    seeds = [{race.seed for race in plan.races()} for plan in (standard, one, other)]
    assert len(set.union(*seeds)) == 3 * len(standard.races())
    strata = [[race.key for race in plan.races()] for plan in (standard, one)]
    assert strata[0] == strata[1]
    rivals = [[order.drivers for order in plan.orders()] for plan in (standard, one)]
    assert rivals[0] != rivals[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"adapter": "adapter.py"}, "unknown setting of a race 'adapter'"),
        ({"fresh": "a", "split": "train"}, "fresh races are for leaderboards, on the test tracks"),
        ({"fresh": "x" * 201}, "fresh is 'xxx.*, expected one line of at most 200 letters"),
        ({"fresh": "a\nb"}, "fresh is .*, expected one line"),
        ({"fresh": 3}, "fresh is 3, expected one line"),
    ],
)
def test_options_that_would_make_other_races_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        plan_entry("solo-general", "random", **options)
