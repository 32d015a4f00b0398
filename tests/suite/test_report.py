"""Reports of runs: numbers, files, and entries that are refused."""

import itertools
import json
import shutil
import sys
from dataclasses import replace

import pytest

from stkzoo.cli import main
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation import Estimate
from stkzoo.suite import (
    TASKS,
    Baselines,
    SuiteReport,
    load_runs,
    make_report,
    write_suite_report,
)
from stkzoo.suite.population import POPULATION, population_digests
from stkzoo.suite.report.document import NORMALIZED
from stkzoo.suite.report.runs import HELD_OUT, SEEN
from stkzoo.suite.report.writing import report_sections
from stkzoo.suite.tasks import SUITE
from tests.support.entries import (
    SMALL,
    change_header,
    name_replays,
    read_entry,
    replay_of,
    write_entry,
)
from tests.support.suite_runs import constant, evaluation_of, plan_of, suite_run, write_run

FILES = {"report.json", "report.md", "marl_eval.json", "scores.svg", "learning_curves.svg"}


@pytest.fixture(autouse=True)
def known_ends(monkeypatch):
    """Makes 0.25 and 0.75 the ends of the scale of *versus*; the other tasks have none."""
    ends = {"random": Estimate(0.25, None, None), "pretrained:zenith": Estimate(0.75, None, None)}
    digests = {name: task.digest for name, task in TASKS.items()}
    made_up = Baselines(SUITE, digests, population_digests(), {"versus": ends})
    for module in ("scores", "report.writing"):
        monkeypatch.setattr(f"stkzoo.suite.{module}.load_baselines", lambda: made_up)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Writes two runs, and an entry of a driver."""
    folder = tmp_path_factory.mktemp("runs")
    for seed in (0, 1):
        write_run(folder, "solo-general", "ippo", seed, constant(1.0 + seed / 10))
    return folder


@pytest.fixture
def runs(written, tmp_path):
    """Returns a copy of that folder."""
    return shutil.copytree(written, tmp_path / "runs")


# ------------------------------------------------------------------ numbers


def only_algorithm(*runs):
    (task,) = make_report(runs).tasks
    (algorithm,) = task.algorithms
    return task, algorithm


def test_scores_are_on_the_scale_of_random_and_zenith():
    task, ippo = only_algorithm(suite_run("versus", "ippo", 0, constant(0.5), constant(0.75)))
    assert task.scale == NORMALIZED
    assert ippo.over_runs == Estimate(0.5, None, None)
    assert (ippo.iqm.value, ippo.gap.value) == (pytest.approx(0.5), pytest.approx(0.5))
    assert ippo.train_score.value == 0.75
    assert ippo.seeds == (0,)
    text = report_sections(make_report([suite_run("versus", "ippo", 0, constant(0.5))]), {})
    assert "in the same races, *random* has 0 and *zenith* 1." in text


@pytest.mark.parametrize(
    ("name", "facts", "iqm", "text"),
    [
        ("team-2v2", {}, 0.5, "*IQM* and *gap* are the metric."),
        ("solo-general", {}, -0.5, "*IQM* and *gap* are the metric with a minus sign."),
        ("versus", {"fresh": "a"}, 0.5, 'The seeds of the races are drawn from "a".'),
    ],
)
def test_without_ends_of_the_scale_scores_are_the_metric(name, facts, iqm, text):
    runs = [suite_run(name, "ippo", 0, constant(0.5), **facts)]
    task, ippo = only_algorithm(*runs)
    assert task.scale == task.metric
    assert ippo.iqm.value == pytest.approx(iqm)
    assert text in report_sections(make_report(runs), {})


def test_intervals_over_runs_and_over_tracks_are_those_of_student():
    tracks = TASKS["versus"].test_tracks

    def on_two_tracks(order, _):
        return order.settings.track in tracks[:2]

    runs = [suite_run("versus", "ippo", seed, constant(seed / 4)) for seed in range(3)]
    _, ippo = only_algorithm(*runs)
    assert ippo.over_tracks == Estimate(0.25, None, None)
    assert ippo.over_runs.interval == pytest.approx((0.25 - 0.621, 0.25 + 0.621), abs=1e-3)
    _, ippo = only_algorithm(suite_run("versus", "ippo", 0, on_two_tracks))
    assert ippo.over_runs == Estimate(pytest.approx(1 / 3), None, None)
    assert ippo.over_tracks.interval == pytest.approx((1 / 3 - 0.542, 1 / 3 + 0.542), abs=1e-3)


def test_forms_and_seen_and_held_out_rivals_have_scores_of_their_own():
    held_out = {member.driver for member in POPULATION if member.is_held_out}

    def beats_held_out(order, kart):
        return order.drivers[kart] in held_out

    run = suite_run("selfplay-5", "ippo", 0, beats_held_out)
    _, ippo = only_algorithm(run)
    assert list(ippo.parts) == ["PBBBB", "PPPPB", SEEN, HELD_OUT]
    assert (ippo.parts[SEEN].value, ippo.parts[HELD_OUT].value) == (0.0, 1.0)
    races = run.test.entry.races
    for form in ("PBBBB", "PPPPB"):
        beaten = [race.beaten for race in races if race.form == form]
        assert ippo.parts[form].value == pytest.approx(sum(beaten) / len(beaten))
    _, alone = only_algorithm(suite_run("versus", "ippo", 0, constant(0.5)))
    assert list(alone.parts) == ["PAAAA"]
    text = report_sections(make_report([run]), {})
    assert "| algorithm | PBBBB | PPPPB | seen rivals | held-out rivals |" in text


def test_classes_are_ranked_apart_and_variants_have_rows_of_their_own():
    runs = [
        *(suite_run("versus", name, 0, constant(0.5)) for name in ("ippo", "mappo")),
        suite_run("versus", "ippo", 0, constant(0.25), variant="argmax"),
        suite_run("versus", "rules", 0, constant(0.75), agent_class="scripted"),
        suite_run("versus", "copies", 0, constant(1.0), agent_class="search"),
    ]
    facts = {"demonstrations": True, "pretraining": "1 M kart-steps | alone"}
    runs.append(suite_run("versus", "imitation", 0, constant(0.5), **facts))
    (task,) = make_report(runs).tasks
    pairs = {(pair.first, pair.second) for pair in task.improvements}
    learned = ("ippo", "mappo", "ippo (argmax)", "imitation")
    assert pairs == set(itertools.combinations(learned, 2))
    text = report_sections(make_report(runs), {})
    for line in (
        "### Learned agents",
        "### Scripted agents",
        "### Search agents",
        "| algorithm | variant | runs | beaten |",
        "| ippo | - | 1 | 0.500 |",
        "| ippo | argmax | 1 | 0.250 |",
        "| rules | - | 1 | 0.750 |",
        "| versus | imitation | learned, demonstrations, 1 M kart-steps / alone | 0 |",
    ):
        assert line in text, text
    assert "variant" not in report_sections(make_report(runs[:2]), {})


def test_the_power_follows_from_the_variance_between_runs():
    runs = [
        suite_run("versus", name, seed, constant(seed / 4 + start))
        for name, start in (("ippo", 0), ("mappo", 0.5))
        for seed in (0, 1)
    ]
    task, *_ = make_report(runs).tasks
    assert (task.power.freedom, task.power.deviation) == (2, pytest.approx(0.25 / 2**0.5))
    assert task.power.runs == {"0.05": 198, "0.1": 51}
    text = report_sections(make_report(runs), {})
    assert "a difference of 0.05 from 198 runs of each algorithm, of 0.1 from 51 runs" in text
    assert make_report(runs[:1]).tasks[0].power is None
    assert make_report([runs[0], replace(runs[0])]).tasks[0].power is None


# ------------------------------------------------------------------ files


@pytest.mark.slow
def test_a_report_has_all_its_files_and_is_reproducible(runs, tmp_path, capsys):
    driver = plan_of("solo-general", "rules", 0, agent_class="scripted")
    evaluation_of(driver, constant(0.9), tmp_path / "entries" / "rules")
    paths = [str(runs), str(tmp_path / "entries")]
    one, two = tmp_path / "one", tmp_path / "two"
    assert main(["suite", "report", *paths, "--output", str(one)]) == 0
    assert f"Wrote the report of 3 runs to {one / 'report.md'}" in capsys.readouterr().out
    write_suite_report([*paths, runs / "solo-general-ippo-0"], two)
    assert {file.name for file in one.iterdir()} == FILES  # a single learned algorithm
    for name in FILES:
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    report = SuiteReport.load(one / "report.json")
    assert report == make_report(load_runs(paths))
    ippo, rules = report.tasks[0].algorithms
    assert (ippo.kart_steps, ippo.training_hours) == (2e6, pytest.approx(2000 / 3600))
    assert ippo.returns.values[-1] == pytest.approx(97.5)
    assert rules.returns is rules.gap is None
    assert "| ippo | 2 | 1.050 | 0.415..1.685 | 1.050..1.050 |" in (one / "report.md").read_text()


@pytest.mark.slow
def test_marl_eval_gets_each_run_with_equal_steps_and_metrics(runs, tmp_path):
    write_suite_report([runs], tmp_path / "report")
    environments = json.loads((tmp_path / "report" / "marl_eval.json").read_text())
    assert list(environments) == ["stkzoo-suite-1", "stkzoo-suite-1-training"]
    for environment, metrics in zip(
        environments.values(), ({"score"}, {"return", "finished", "position"}), strict=True
    ):
        seeds = environment["solo-general"]["ippo"]
        assert list(seeds) == ["seed_0", "seed_1"]
        for steps in seeds.values():
            assert set(steps["absolute_metrics"]) == metrics
            counts = [step["step_count"] for name, step in steps.items() if "step_" in name]
            assert counts == sorted(counts)
            assert all(set(step) - {"step_count"} == metrics for step in steps.values())
            assert list(steps)[:-1] == [f"step_{n}" for n in range(len(counts))]
    score = environments["stkzoo-suite-1"]["solo-general"]["ippo"]["seed_0"]["absolute_metrics"][
        "score"
    ]
    assert score == pytest.approx([-1.0] * TASKS["solo-general"].num_races)


def test_a_missing_library_is_named(runs, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert main(["suite", "report", str(runs), "--output", str(tmp_path / "report")]) == 2
    assert (
        "the plot needs matplotlib (extra races), which is not installed" in capsys.readouterr().err
    )


@pytest.mark.matrix
def test_an_agent_is_trained_evaluated_verified_and_reported(tmp_path, monkeypatch, capsys):
    """The commands of the documentation follow each other without any other program."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(TASKS, SMALL.name, replace(SMALL, forms=("P",), metric="time_ratio"))
    for seed in ("0", "1"):
        agent = f"runs/small-ippo-{seed}/agent"
        words = ["small", "ippo", "--kart-steps", "200", "--seed", seed]
        assert main(["suite", "train", *words]) == 0
        assert f"stkzoo suite evaluate small {agent}" in capsys.readouterr().out
        for split in ("test", "train"):
            assert main(["suite", "evaluate", "small", agent, "--split", split]) == 0
    assert main(["suite", "verify", "runs/small-ippo-1/entry", "--agent", agent]) == 0
    assert main(["suite", "report", "runs"]) == 0
    assert "Wrote the report of 2 runs to suite/report/report.md" in capsys.readouterr().out
    assert "| ippo | 2 |" in (tmp_path / "suite" / "report" / "report.md").read_text()


# ------------------------------------------------------------------ refused


def test_result_files_without_an_entry_are_refused_in_one_sentence(tmp_path, capsys):
    files = [tmp_path / f"versus-nova-{seed}.json" for seed in range(3)]
    for file in files:
        file.write_text(json.dumps({"type": "suite-run", "score": 1.0}))
    for paths in (files, [tmp_path], [tmp_path / "nothing"]):
        assert main(["suite", "report", *map(str, paths)]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert f"{paths[0]} has no entry (entry.json, replays); expected the folder of" in error


def of_card(change):
    """Returns a function that changes the card of an entry in its folder."""

    def edit(folder):
        card = read_entry(folder)
        change(card)
        write_entry(folder, card)

    return edit


def about(**facts):
    return of_card(lambda card: card["plan"]["about"].update(facts))


def finish_sooner(card):
    card["races"][0]["time_ratio"] = 0.5
    card["races"][0]["karts"][0]["time"] /= 2


def swap_replays(folder):
    contents = [replay_of(folder, number).read_bytes() for number in (2, 0)]
    for number, content in zip((0, 2), contents, strict=True):
        replay_of(folder, number).write_bytes(content)
    name_replays(folder)


def evaluate_again(folder):
    evaluation_of(plan_of("solo-general", "ippo", 0), constant(0.7), folder.parent / "again")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (of_card(finish_sooner), r"is refused:\nrace 0 .*forward\), step 1: karts\[0\]\.time is"),
        (
            lambda folder: change_header(folder, 1, lambda header: header.update(status="x")),
            r"race 1 \(.* reversed\): the replay is not the one of entry\.json",
        ),
        (swap_replays, "race 0 .*: the replay is of another race"),
        (lambda folder: replay_of(folder, 3).unlink(), "see 00003.stkz"),
        (of_card(lambda c: [c[n].pop() for n in ("races", "replays")]), "it has 59 of 60 races"),
        (of_card(lambda c: c["plan"].update(task_digest="0" * 64)), "task_digest of the plan"),
        (about(agent_class=None), "'ippo 0' has no class; choose one of"),
        (about(kart_steps=1_950_000), "with 1950000 kart-steps, and .*log.jsonl ends at 2000000"),
        (
            lambda folder: (folder.parent / "log.jsonl").write_text("[]\n"),
            "log.jsonl is not the log of a training",
        ),
        (
            lambda folder: shutil.copytree(folder, folder.parent / "copy"),
            "entry have the same replays; leave one out",
        ),
        (evaluate_again, "are of the same run, solo-general, ippo, 0; leave one out"),
        (shutil.rmtree, "has the training tracks of solo-general, ippo, 0, and its entry is"),
    ],
)
def test_a_changed_entry_is_refused(runs, change, message):
    change(runs / "solo-general-ippo-0" / "entry")
    with pytest.raises(StkzooError, match=message):
        load_runs([runs])


@pytest.mark.parametrize(
    ("facts", "message"),
    [
        (
            {"fresh": "a"},
            r"are those of the task \(.*\) and fresh ones from 'a' \(.*mappo\); write a",
        ),
        ({"kart_steps": 10_000_000}, r"learned from 2,000,000 \(.*\) and 10,000,000 \(.*mappo"),
    ],
)
def test_runs_that_cannot_be_compared_are_refused(runs, facts, message):
    evaluation_of(plan_of("solo-general", "mappo", 0, **facts), constant(1.0), runs / "mappo")
    with pytest.raises(ConfigError, match=message):
        load_runs([runs])
