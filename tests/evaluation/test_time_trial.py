"""Time trials against human records: plans, figures, resumed runs and the command."""

import json

import jsonschema
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.evaluation import (
    TimeTrialResult,
    load_benchmark,
    load_time_trial,
    plan_time_trial,
    run_time_trial,
)
from stkzoo.evaluation.benchmark.time_trial import TIME_TRIALS
from stkzoo.records import HUMAN_RECORDS
from tests.support.paths import ROOT
from tests.support.results import agent_result, race_result

SCHEMA = ROOT / "docs" / "schemas" / "time-trial-result.schema.json"
SHIPPED = ROOT / "benchmarks" / "results" / "benchmark" / "ace-time-trial.json"


# ------------------------------------------------------------------ the plan


def test_the_races_have_the_conditions_of_the_records():
    plan = plan_time_trial("heuristic", seeds=2)
    orders = plan.orders()
    assert [order.settings.track for order in orders] == [*HUMAN_RECORDS] * 2
    assert {order.drivers for order in orders} == {("heuristic@:heuristic",)}
    for order in orders:
        settings = order.settings
        assert (settings.mode, settings.kart) == ("time_trial", "pidgin")
        assert (settings.difficulty, settings.reverse) == (3, False)
        assert settings.laps == HUMAN_RECORDS[settings.track].laps
        assert settings.max_steps * 0.1 > 3 * HUMAN_RECORDS[settings.track].seconds


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mode": "normal"}, "unknown setting of a race 'mode'"),
        ({"seeds": 0}, "seeds is 0, expected a whole number from 1"),
    ],
)
def test_invalid_time_trials_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        plan_time_trial("heuristic", **options)


# ------------------------------------------------------------------ the figures


def result_of(order, time):
    row = agent_result(1, time, rank=1, status="racing" if time is None else "finished")
    race = {name: getattr(order.settings, name) for name in ("track", "laps", "seed")}
    return race_result([row], **race, mode="time_trial")


def outcome(multiples, **options):
    """Makes a result with times in multiples of the record; ``None`` for unfinished races."""
    plan = plan_time_trial("heuristic", **options)
    results = {}
    for order, multiple in zip(plan.orders(), multiples, strict=False):
        record = HUMAN_RECORDS[order.settings.track].seconds
        results[order.number] = result_of(order, None if multiple is None else multiple * record)
    return TIME_TRIALS.summarize(plan, results, None)


def test_the_figures_are_multiples_of_the_records():
    result = outcome([1.15, 1.2, None], split=["lighthouse", "hacienda", "mines"])
    ratios = {track.track: track.ratio for track in result.tracks}
    assert ratios == {"lighthouse": 1.15, "hacienda": 1.2, "mines": 3.0}
    assert result.mean_ratio == pytest.approx((1.15 + 1.2 + 3.0) / 3, abs=1e-4)
    assert (result.close, result.unfinished) == (1, ("mines",))
    assert result.tracks[2].time is None


def test_an_incomplete_time_trial_has_a_result():
    result = outcome([1.3], split=["lighthouse", "hacienda"])
    assert (result.is_complete, result.mean_ratio) == (False, 1.3)
    assert outcome([], split="mines").mean_ratio is None


def test_a_result_survives_a_json_round_trip():
    result = outcome([1.3, None], split=["lighthouse", "hacienda"])
    assert TimeTrialResult.from_json(result.to_json()) == result
    jsonschema.validate(json.loads(result.to_json()), json.loads(SCHEMA.read_text()))


def test_a_result_with_races_of_another_plan_is_refused():
    values = json.loads(outcome([1.3], split="mines").to_json())
    values["races"][0]["seed"] += 1
    with pytest.raises(ConfigError, match="race 0 of the time trial result is"):
        TimeTrialResult.from_json(json.dumps(values))


def test_a_time_trial_is_not_a_benchmark(tmp_path):
    (tmp_path / "result.json").write_text(outcome([1.3], split="mines").to_json())
    with pytest.raises(ConfigError, match="is a time-trial-result"):
        load_benchmark(tmp_path)


def test_the_shipped_result_is_complete_and_valid():
    jsonschema.validate(json.loads(SHIPPED.read_text()), json.loads(SCHEMA.read_text()))
    result = load_time_trial(SHIPPED)
    assert result.is_complete
    assert len(result.tracks) == 21


# ------------------------------------------------------------------ on the real engine


@pytest.mark.slow
def test_a_run_is_stored_and_the_command_resumes_it_without_racing_again(tmp_path, capsys):
    options = {"split": "olivermath", "jobs": 1, "plot": False}
    heard = []
    first = run_time_trial("ai", output=tmp_path, **options)
    again = run_time_trial("ai", output=tmp_path, on_race=heard.append, **options)
    assert again == first == load_time_trial(tmp_path)
    assert [(progress.done, progress.last) for progress in heard] == [(1, None)]
    (track,) = first.tracks
    assert (track.laps, track.finished) == (6, 1)
    assert 1.0 < track.ratio < 2.5
    words = ["ai", "--time-trial", "--track", "olivermath", "--output", str(tmp_path)]
    assert main(["benchmark", *words]) == 0
    shown = capsys.readouterr().out
    assert all(text in shown for text in ("57.08", "unfinished: -."))
    assert (tmp_path / "benchmark.png").stat().st_size > 1000
