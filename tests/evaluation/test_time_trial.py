"""Time trials against human records: plans, figures, resumed runs and the command."""

import json
from dataclasses import replace

import jsonschema
import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError
from stkzoo.evaluation import (
    BenchmarkResult,
    compare,
    load_benchmark,
    plan_benchmark,
    plan_time_trial,
    run_time_trial,
)
from stkzoo.evaluation.benchmark.result import BENCHMARK
from stkzoo.records import HUMAN_RECORDS
from tests.support.paths import ROOT
from tests.support.results import agent_result, race_result

SCHEMA = ROOT / "docs" / "schemas" / "benchmark-result.schema.json"
SAVED = sorted((ROOT / "benchmarks" / "results" / "benchmark").glob("*-time-trial.json"))


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


def test_a_track_without_a_record_is_refused():
    plan = plan_time_trial("heuristic", split="lighthouse")
    with pytest.raises(ConfigError, match="my_track has no human record; leave it out of --track"):
        replace(plan, tracks=("my_track",))


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
    return BENCHMARK.summarize(plan, results, None)


def test_the_figures_are_multiples_of_the_records():
    result = outcome([1.15, 1.2, None], split=["lighthouse", "hacienda", "mines"])
    ratios = [group.figures["time_ratio"].value for group in result.groups if group.by == "track"]
    assert ratios == pytest.approx([1.15, 1.2, 3.0], abs=1e-5)
    figures = result.group().figures
    assert figures["time_ratio"].value == pytest.approx((1.15 + 1.2 + 3.0) / 3, abs=1e-5)
    assert figures["unfinished"].value == pytest.approx(1 / 3)


def test_a_result_survives_a_json_round_trip():
    result = outcome([1.3, None], split=["lighthouse", "hacienda"])
    assert BenchmarkResult.from_json(result.to_json()) == result


def test_time_trials_are_compared_with_each_other_only():
    one, other = (outcome([ratio], split="lighthouse") for ratio in (1.2, 1.5))
    assert compare(one, other).difference().figures["time_ratio"].value == pytest.approx(-0.3)
    benchmark = BENCHMARK.summarize(plan_benchmark("heuristic", split="lighthouse"), {}, None)
    with pytest.raises(ConfigError, match="mode is 'normal' and was 'time_trial'"):
        compare(one, benchmark)


@pytest.mark.parametrize("file", SAVED, ids=lambda file: file.stem)
def test_a_saved_result_is_complete_and_valid(file):
    jsonschema.validate(json.loads(file.read_text()), json.loads(SCHEMA.read_text()))
    result = load_benchmark(file)
    assert result.is_complete
    for race in result.races:
        (kart,) = race.karts
        assert race.time_ratio == pytest.approx(kart.time / HUMAN_RECORDS[race.track].seconds)


# ------------------------------------------------------------------ on the real engine


@pytest.mark.slow
def test_a_run_is_stored_and_the_command_resumes_it_without_racing_again(tmp_path, capsys):
    options = {"split": "olivermath", "jobs": 1, "plot": False}
    heard = []
    first = run_time_trial("ai", output=tmp_path, **options)
    again = run_time_trial("ai", output=tmp_path, on_race=heard.append, **options)
    assert again == first == load_benchmark(tmp_path)
    assert [(progress.done, progress.last) for progress in heard] == [(1, None)]
    (race,) = first.races
    assert 1.0 < race.time_ratio < 2.5
    words = ["ai", "--time-trial", "--track", "olivermath", "--output", str(tmp_path)]
    assert main(["benchmark", *words]) == 0
    assert f"{race.time_ratio:.3f}" in capsys.readouterr().out
    assert (tmp_path / "benchmark.png").stat().st_size > 1000
