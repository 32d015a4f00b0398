"""Ratings of saved policies of runs against one another."""

import json
import shutil
from collections import Counter

import numpy as np
import pytest

from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.agents.training import rate
from stkzoo.agents.training.common.matches import Finish, Match, MatchRecord, play_matches
from stkzoo.agents.training.rate import START, draw_match, kept_policies, main, run_drivers
from stkzoo.errors import ConfigError
from tests.support.networks import small_network


@pytest.fixture
def run(tmp_path):
    """Makes a run's folder whose later policies only turn left."""
    folder = tmp_path / "first"
    folder.mkdir()
    for number, steps in enumerate((100, 1_000_100, 2_000_200)):
        weights = dict(RacingPolicy.of_plans_alone().weights)
        if number:
            weights["b2"] = np.zeros(15, np.float32)
            weights["b2"][4] = 50.0 * number
        save_weights(folder / f"policy-{steps:09d}.safetensors", weights)
    return folder


def test_policies_are_named_by_run_and_steps(run):
    assert [*kept_policies([run], 0)] == ["first 0.00", "first 1.00", "first 2.00"]
    assert [*kept_policies([run], 1_500_000)] == ["first 0.00", "first 2.00"]
    with pytest.raises(ConfigError, match="the runs other names"):
        kept_policies([run, run], 0)
    with pytest.raises(ConfigError, match="is it a run's folder"):
        kept_policies([run.parent], 0)


def test_policies_with_almost_as_many_steps_have_names_of_their_own(run):
    save_weights(run / "policy-001000200.safetensors", RacingPolicy.of_plans_alone().weights)
    names = [*kept_policies([run], 0)]
    assert names == ["first 0.000100", "first 1.000100", "first 1.000200", "first 2.000200"]


def test_all_policies_race_equally_often_and_on_all_tracks():
    names = [f"p{n}" for n in range(7)]
    matches = [draw_match(names, number) for number in range(28)]
    assert Counter(name for match in matches for name in match.drivers) == dict.fromkeys(names, 16)
    assert len({(match.track, match.reverse) for match in matches}) == 28
    assert draw_match(names, 5) == matches[5]


@pytest.mark.usefixtures("drawn")
def test_all_policies_race_on_the_given_tracks(run, tmp_path, capsys):
    folder = tmp_path / "out"
    words = [str(run), "--every=0", f"--output={folder}"]
    assert main([*words, "--matches=5", "--track", "mines", "hacienda"]) == 0
    lines = (folder / "matches.jsonl").read_text().splitlines()
    assert {json.loads(line)["track"] for line in lines} == {"mines", "hacienda"}
    assert main([*words, "--matches=9", "--track", "abyss"]) == 1
    assert "expected policies of these runs on 'abyss'; give the same" in capsys.readouterr().err


@pytest.fixture
def drawn(monkeypatch):
    """The curves that a rating draws; its races are not driven."""
    curves = {}

    def without_driving(matches, _):
        return [MatchRecord(0, each.track, each.reverse, [*each.drivers]) for each in matches]

    monkeypatch.setattr(rate, "play_records", without_driving)
    monkeypatch.setattr(rate, "rating_figure", lambda found, *_: curves.update(found))
    monkeypatch.setattr(rate, "save_figure", lambda *_: None)
    return curves


@pytest.mark.slow
def test_a_curve_has_only_the_policies_of_its_own_run(run, tmp_path, drawn):
    longer = run.with_name("first b")
    shutil.copytree(run, longer)
    words = [str(run), str(longer), "--every=0", "--matches=14", f"--output={tmp_path / 'out'}"]
    assert main(words) == 0
    steps = {name: [at for at, _ in points] for name, points in drawn.items()}
    expected = [0.0, 0.0001, 1.0001, 2.0002]
    assert steps == {"first": expected, "first b": expected}


@pytest.mark.matrix
def test_better_policies_are_rated_higher_and_races_can_be_added(run, tmp_path, capsys):
    words = [str(run), "--every=0", f"--output={tmp_path / 'out'}", "--track=olivermath"]
    assert main([*words, "--matches=1"]) == 0
    first = (tmp_path / "out" / "matches.jsonl").read_text()
    assert main([*words, "--matches=3"]) == 0
    lines = (tmp_path / "out" / "matches.jsonl").read_text()
    assert lines.startswith(first)
    assert lines.count("\n") == 3
    kept = json.loads((tmp_path / "out" / "ratings.json").read_text())
    value = {row["name"]: row["value"] for row in kept["ratings"]}
    assert {*value} == {START, "ai", "first 0.00", "first 1.00", "first 2.00"}
    assert value[START] > value["first 2.00"]
    assert value["first 0.00"] > value["first 1.00"]
    assert (tmp_path / "out" / "ratings.png").read_bytes().startswith(b"\x89PNG")
    assert "3 of 3 races" in capsys.readouterr().out


def test_too_few_policies_are_refused(run, tmp_path, capsys):
    assert main([str(run), "--every=9000000", f"--output={tmp_path / 'out'}"]) == 1
    assert "expected 4 or more" in capsys.readouterr().err


@pytest.mark.slow
def test_runs_of_all_scripts_are_rated_together(run):
    plans = run / "policy-000000100.safetensors"
    network = run.parent / "network.safetensors"
    save_weights(network, small_network())
    drivers = run_drivers({"plans": plans, "network": network})
    assert {*drivers} == {"plans", "network", START}
    match = Match(("plans", "network", START), "olivermath", bots=0)
    (finishes,) = play_matches([match], drivers)
    assert sorted(finish.rank for finish in finishes) == [1, 2, 3]
    assert match.order(finishes)[-1] == "network"  # it does not follow the road


def test_ranks_without_a_driver_belong_to_the_ai():
    match = Match(("a", "b", "a"), "lighthouse", bots=2)
    ends = [Finish(1.0, rank) for rank in (1, 3, 4)]
    assert match.order(ends) == ["a", "ai", "b"]
