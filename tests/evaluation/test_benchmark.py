"""The benchmark: the same races for all agents, and correct figures with intervals."""

import json
from dataclasses import astuple

import numpy as np
import pytest

from stkzoo.errors import ConfigError
from stkzoo.evaluation import (
    BenchmarkForm,
    BenchmarkResult,
    KartOutcome,
    RaceOutcome,
    compare,
    load_benchmark,
    plan_benchmark,
)
from stkzoo.evaluation.benchmark.races import make_races, race_seed
from stkzoo.evaluation.statistics import estimate_mean
from stkzoo.tracks import TEST_TRACKS
from tests.support.paths import ROOT
from tests.support.results import agent_result, race_result

RESULTS = ROOT / "benchmarks" / "results" / "benchmark"
FORMS = [BenchmarkForm.of(name) for name in ("PAAAA", "PPAAA", "P")]


# ------------------------------------------------------------------ races


def test_the_test_split_has_three_hundred_races_with_different_seeds():
    races = make_races(TEST_TRACKS, (False, True), FORMS, 5)
    assert len(races) == 6 * 2 * (2 + 2 + 1) * 5
    assert [race.number for race in races] == list(range(300))
    assert len({race.seed for race in races}) == 300


def test_seeds_are_those_of_all_published_results():
    assert race_seed("lighthouse", False, "PAAAA", "front", 0) == 207341991
    assert race_seed("xr591", True, "P", "front", 4) == 1370257659


@pytest.mark.parametrize("name", ["", "AP", "pa", "P" * 21])
def test_invalid_race_forms_are_refused(name):
    with pytest.raises(ConfigError, match="expected P for each kart of the agent"):
        BenchmarkForm.of(name)


def test_orders_follow_the_race_form():
    plan = plan_benchmark("random@:dice", split="lighthouse", seeds=1, reverse=[True])
    by_race = dict(zip(plan.races(), plan.orders(), strict=True))
    found = {(race.form, race.end): order for race, order in by_race.items()}
    dice = "random@:dice"
    assert found["PPAAA", "back"].drivers == ("ai", "ai", "ai", dice, dice)
    assert found["PPAAA", "back"].wait_for == (3, 4)
    assert found["PAAAA", "front"].drivers == (dice, "ai", "ai", "ai", "ai")
    assert found["P", "front"].drivers == (dice,)
    settings = found["P", "front"].settings
    assert (settings.track, settings.reverse, settings.difficulty) == ("lighthouse", True, 3)
    limit = 3 * plan.reference_time("lighthouse", True)
    assert limit <= (settings.max_steps - 20) / 10 < limit + 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"split": "lighthous"}, "Did you mean 'lighthouse'"),
        ({"seeds": 0}, "seeds is 0, expected a whole number from 1"),
        ({"difficulty": 4}, "difficulty is 4"),
        ({"forms": []}, "expected different race forms"),
        ({"forms": ["P", "P"]}, "expected different race forms"),
        ({"reverse": []}, "expected \\(False, True\\) or one of both"),
        ({"reverse": [2]}, "expected \\(False, True\\) or one of both"),
        ({"max_steps": 5}, "max_steps"),
        ({"error_handling": "raise"}, "choose retire, catch or restart"),
    ],
)
def test_invalid_benchmarks_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        plan_benchmark("heuristic", **options)


# ------------------------------------------------------------------ values of one race


def result_of(*rows):
    """Makes a race's result from rows of start position, finish time, rank and status."""
    agents = [
        agent_result(place, time, rank=rank, status=status, rescues=place)
        for place, time, rank, status in rows
    ]
    return race_result(sorted(agents, key=lambda row: row.rank), track="lighthouse", seed=1)


def outcome_of(form, end, *rows, ai_time=40.0):
    races = make_races(["lighthouse"], [False], [BenchmarkForm.of(form)], 1)
    (race,) = [race for race in races if race.end == end]
    return RaceOutcome.of(race, result_of(*rows), ai_time, limit=3.0)


def test_two_karts_of_the_agent_count_with_their_mean():
    outcome = outcome_of(
        "PPAA",
        "back",
        (1, 40.0, 2, "finished"),
        (2, None, 4, "racing"),
        (3, 36.0, 1, "finished"),
        (4, 48.0, 3, "finished"),
    )
    assert outcome.time_ratio == pytest.approx((0.9 + 1.2) / 2)
    assert (outcome.is_won, outcome.rank, outcome.unfinished) == (1.0, 2.0, 0.0)
    assert outcome.rescues == 3.5
    assert [kart.time for kart in outcome.karts] == [36.0, 48.0]


def test_an_unfinished_kart_counts_with_the_time_limit():
    alone = outcome_of("P", "front", (1, 38.0, 1, "finished"))
    assert (alone.time_ratio, alone.is_won, alone.rank) == (pytest.approx(0.95), None, None)
    outcome = outcome_of("PA", "front", (1, None, 2, "racing"), (2, 40.0, 1, "finished"))
    assert (outcome.time_ratio, outcome.is_won, outcome.rank) == (3.0, 0.0, 2.0)
    assert outcome.unfinished == 1.0


def test_an_agent_that_fails_while_leading_is_last():
    rows = [(1, None, 1, "retired"), (2, None, 2, "racing"), (3, None, 3, "racing")]
    outcome = outcome_of("PAA", "front", *rows)
    assert (outcome.rank, outcome.is_won, outcome.time_ratio) == (3.0, 0.0, 3.0)
    both = outcome_of("PPA", "front", *rows)
    assert both.rank == 2.5
    assert [kart.rank for kart in both.karts] == [2, 3]


# ------------------------------------------------------------------ intervals


def test_differences_between_strata_do_not_widen_the_interval():
    """Tracks are fixed, so a difference between them is not a random error."""
    found = estimate_mean([1.0, 1.0, 9.0, 9.0], ["a", "a", "b", "b"])
    assert (found.value, found.low, found.high) == (5.0, 5.0, 5.0)


def test_the_interval_contains_the_true_mean_at_the_stated_rate():
    chance = np.random.default_rng(2)
    strata = [row for row in range(12) for _ in range(5)]
    hits = 0
    for _ in range(300):
        found = estimate_mean(chance.normal(size=60).tolist(), strata)
        hits += found.low <= 0.0 <= found.high
    assert 273 <= hits <= 296  # 91 to 98.7%


def test_a_rate_of_zero_has_an_upper_bound():
    found = estimate_mean([0.0] * 30, ["a"] * 15 + ["b"] * 15, (0.0, 1.0))
    assert (found.value, found.low) == (0.0, 0.0)
    assert (1 - found.high) ** 30 == pytest.approx(0.025)
    found = estimate_mean([1.0] * 5 + [0.0] * 5, ["a"] * 5 + ["b"] * 5, (0.0, 1.0))
    assert found.low < 0.5 < found.high


# ------------------------------------------------------------------ results and comparisons


def made_up(ratio, won, *, seeds=5, **changes):
    """Makes a result in which two functions give the agent's time ratio and win of each race."""
    options = {"split": "lighthouse", "forms": ["PA"], "seeds": seeds, **changes}
    plan = plan_benchmark("random", **options)
    outcomes = []
    for race in plan.races():
        time = ratio(race) * plan.reference_time(race.track, race.reverse)
        kart = KartOutcome(time, 1 if won(race) else 2, 0, 0)
        outcomes.append(RaceOutcome(*astuple(race), "awaited_finished", ratio(race), (kart,)))
    return BenchmarkResult(plan, tuple(outcomes))


def test_groups_have_the_means_of_their_races():
    result = made_up(lambda race: 1.1 if race.reverse else 0.9, lambda race: race.end == "front")
    for name, ratio in (("forward", 0.9), ("reversed", 1.1)):
        figures = result.group("direction", name).figures
        assert figures["time_ratio"].value == pytest.approx(ratio)
    everything = result.group()
    assert everything.figures["time_ratio"].value == pytest.approx(1.0)
    assert everything.figures["win_rate"].value == 0.5
    assert everything.chance == 0.5
    assert everything.races == 20
    assert result.group("end", "back").figures["mean_rank"].value == 2.0
    assert result.group("track and direction", "lighthouse reversed").races == 10


def test_a_result_survives_a_json_round_trip():
    result = made_up(lambda race: 1 + race.index / 10, lambda race: race.index == 0)
    again = BenchmarkResult.from_json(result.to_json())
    assert again.plan == result.plan
    assert again.groups == result.groups
    with pytest.raises(ConfigError, match="has no benchmark result"):
        BenchmarkResult.from_json("{}")


def test_a_paired_difference_has_a_narrower_interval_than_its_figures():
    """Luck that both agents share cancels out."""
    luck = dict(enumerate(np.random.default_rng(3).normal(1, 0.2, 20)))
    slow = made_up(lambda race: luck[race.number] + 0.05, lambda _: False)
    fast = made_up(lambda race: luck[race.number] + race.index / 1000, lambda _: True)
    found = compare(slow, fast).difference().figures
    assert found["time_ratio"].value == pytest.approx(0.048)
    assert found["time_ratio"].low > 0.04
    alone = slow.group().figures["time_ratio"]
    assert alone.high - alone.low > 10 * (found["time_ratio"].high - found["time_ratio"].low)
    assert found["win_rate"].value == -1.0
    assert found["mean_rank"].value == 1.0


def test_only_races_that_both_agents_have_driven_are_compared():
    one = made_up(lambda _: 1.0, lambda _: True, seeds=2, reverse=[False])
    other = made_up(lambda race: 2.0 if race.reverse else 1.2, lambda _: True, seeds=4)
    found = compare(one, other).difference()
    assert found.races == 4
    assert found.figures["time_ratio"].value == pytest.approx(-0.2)
    with pytest.raises(ConfigError, match="have no race in common"):
        compare(one, made_up(lambda _: 1.0, lambda _: True, reverse=[True]))


def test_results_under_different_conditions_are_not_compared():
    one = made_up(lambda _: 1.0, lambda _: True)
    other = made_up(lambda _: 1.0, lambda _: True, difficulty=2)
    with pytest.raises(ConfigError, match=r"different conditions: .*difficulty is 2 and was 3"):
        compare(one, other)


def of_all_tracks(ratio, **changes):
    """Makes a result on the test tracks in which a function gives the time ratio of a race."""
    return made_up(ratio, lambda _: False, split="test", **changes)


def test_intervals_over_tracks_are_wider_than_those_for_fixed_tracks():
    ratios = {track: 0.8 + 0.05 * number for number, track in enumerate(TEST_TRACKS)}
    group = of_all_tracks(lambda race: ratios[race.track] + race.index / 1000).group()
    own, clustered = group.figures["time_ratio"], group.clustered["time_ratio"]
    assert clustered.value == pytest.approx(own.value)
    assert clustered.low < 0.9 < own.low < own.high < 0.96 < clustered.high
    assert group.clustered["win_rate"].low is None  # no race was won on any track


def test_differences_have_intervals_over_tracks():
    slow = {track: number / 100 for number, track in enumerate(TEST_TRACKS)}
    one, other = of_all_tracks(lambda race: 0.9 + slow[race.track]), of_all_tracks(lambda _: 0.9)
    found = compare(one, other).difference().clustered["time_ratio"]
    assert found.value == pytest.approx(0.025)
    assert 0.012 < found.low < 0.02 < 0.03 < found.high < 0.04


@pytest.mark.parametrize("name", ["ai", "heuristic", "random"])
def test_published_results_follow_the_protocol(name):
    result = load_benchmark(RESULTS / f"{name}.json")
    plan = plan_benchmark(name, seeds=result.plan.seeds)
    assert result.is_complete
    assert (result.label, result.plan.tracks, result.plan.forms) == (name, plan.tracks, plan.forms)
    assert result.plan.ai_times == plan.ai_times
    written = json.loads((RESULTS / f"{name}.json").read_text())["groups"][0]["figures"]
    for figure, found in result.group().figures.items():
        assert [written[figure][end] for end in ("low", "high")] == pytest.approx(
            [found.low, found.high], abs=1e-6
        )


def test_the_ai_ties_with_itself():
    """The AI is the one agent whose true figures are known."""
    result = load_benchmark(RESULTS / "ai.json")
    for form, chance in (("PAAAA", 0.2), ("PPAAA", 0.4)):
        figures = result.group("form", form).figures
        for figure, truth in (("time_ratio", 1.0), ("win_rate", chance), ("mean_rank", 3.0)):
            assert figures[figure].low < truth < figures[figure].high
