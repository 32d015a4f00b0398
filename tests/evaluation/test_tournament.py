"""Tournaments run every race exactly once, even after interruptions."""

import hashlib
import json
import os
import re
import shutil
import sys
from types import SimpleNamespace as Namespace

import jsonschema
import pytest

from stkzoo._installation import install_command
from stkzoo.cli import main
from stkzoo.drivers.sandbox import bubblewrap_problem
from stkzoo.errors import ConfigError
from stkzoo.evaluation import (
    BatchError,
    TournamentResult,
    load_tournament,
    plan_tournament,
    resume_tournament,
    run_tournament,
)
from stkzoo.evaluation.batch import agents as batch_agents
from stkzoo.evaluation.batch.agents import fingerprint
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.ratings import rate
from stkzoo.evaluation.tournament.plan import resumed_plan
from stkzoo.race import RaceResult, RaceSettings
from tests.support.adversaries import write_sore_loser
from tests.support.paths import AGENTS, SCHEMAS
from tests.support.processes import children_of
from tests.support.remote_race import write_agent

SCHEMA = SCHEMAS / "tournament-result.schema.json"
SMALL = {"tracks": ["lighthouse"], "races": 4, "per_race": 3, "max_steps": 15, "plot": False}
#: Starts one program for the races, and none for the agents.
IN_ONE_PROGRAM = SMALL | {"inline": True, "jobs": 1}
THREE = ["heuristic", "ai", "random"]


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tournament") / "cup"
    heard = []
    agents = ["heuristic", "ai", str(AGENTS / "plain"), str(AGENTS / "hostile" / "exits.py")]
    result = run_tournament(
        agents,
        output=folder,
        tracks=["lighthouse", "olivermath"],
        races=4,
        per_race=3,
        max_steps=20,
        jobs=2,
        on_race=heard.append,
    )
    return folder, result, heard


def races_in(folder):
    return sorted(file.name for file in (folder / "races").glob("[0-9]*.json"))


# ------------------------------------------------------------------ results


@pytest.mark.slow
def test_all_races_have_the_planned_grids_and_progress_is_reported(small):
    folder, result, heard = small
    assert [progress.done for progress in heard] == list(range(5))
    assert {progress.total for progress in heard} == {4}
    assert heard[-1].last.steps == 20
    plan = result.plan
    assert races_in(folder) == [f"{number:05d}.json" for number in range(4)]
    for race in plan.schedule():
        text = (folder / "races" / f"{race.number:05d}.json").read_text()
        rows = RaceResult.from_json(text).agents
        grid = [row.driver for row in sorted(rows, key=lambda row: row.start_position)]
        assert grid == [plan.agents[number].label for number in race.grid]


@pytest.mark.slow
def test_an_agent_that_fails_loses_only_its_own_races(small):
    _, result, _ = small
    last = result.standings[-1]
    assert (last.label, last.retired, last.races) == ("exits", 3, 3)
    assert last.mean_rank == 3.0
    assert [row.errors for row in result.standings[:-1]] == [0, 0, 0]
    assert all(race.order[-1] == "exits" for race in result.races if "exits" in race.order)


@pytest.mark.slow
def test_the_result_follows_its_schema(small):
    folder, result, _ = small
    written = json.loads((folder / "result.json").read_text())
    jsonschema.validate(written, json.loads(SCHEMA.read_text()))
    assert written == json.loads(result.to_json())
    assert written["is_complete"]


@pytest.mark.slow
def test_the_matrix_counts_meetings(small):
    _, result, _ = small
    labels = [row.label for row in result.standings]
    for one, first in enumerate(labels):
        for two, second in enumerate(labels):
            met = sum(first in race.order and second in race.order for race in result.races)
            expected = 0 if one == two else met
            assert result.ahead[one][two] + result.ahead[two][one] == expected
    assert result.payoff(0, 3) == 1.0
    assert result.payoff(0, 0) is None


@pytest.mark.slow
def test_a_finished_tournament_repeats_no_races(small):
    folder, result, _ = small
    stamps = [file.stat().st_mtime_ns for file in sorted((folder / "races").iterdir())]
    assert resume_tournament(folder) == result
    assert load_tournament(folder) == result
    assert stamps == [file.stat().st_mtime_ns for file in sorted((folder / "races").iterdir())]


# ------------------------------------------------------------------ ratings


def test_better_agents_are_rated_better():
    ratings = rate([[0, 1, 2], [0, 2, 1], [0, 1, 2], [1, 0, 2]] * 5, 3)
    assert ratings[0].value > ratings[1].value > ratings[2].value
    assert all(rating.low < rating.value < rating.high for rating in ratings)


@pytest.mark.parametrize(
    ("intervals", "groups"),
    [
        ([(30, 40), (29, 33), (20, 29), (19, 28)], (1, 1, 2, 2)),
        ([(30, 40), (39, 41), (31, 38)], (1, 1, 2)),  # the third overlaps only the first
        ([(30, 40), (10, 20), (5, 35)], (1, 2, 2)),  # never better than somebody rated better
        ([(25, 25), (25, 25)], (1, 1)),
    ],
)
def test_all_intervals_of_a_group_overlap(intervals, groups):
    standings = [Namespace(rating=Namespace(low=low, high=high)) for low, high in intervals]
    assert TournamentResult.groups.fget(Namespace(standings=standings)) == groups


@pytest.mark.parametrize("module", ["openskill.models", "jinja2"])
def test_a_missing_library_is_an_error_before_the_first_race(module, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=re.escape(install_command("races"))):
        run_tournament(["ai", "random"], output=tmp_path / "cup", races=1)
    assert not (tmp_path / "cup").exists()


def test_agents_at_the_same_place_are_tied():
    tied, ordered = rate([[0, 1]] * 4, 2, places=[[2, 2]] * 4), rate([[0, 1]] * 4, 2)
    assert tied[0].value == pytest.approx(tied[1].value)
    assert ordered == rate([[0, 1]] * 4, 2, places=[[1, 2]] * 4)
    assert ordered[0].value > ordered[1].value + 3


@pytest.mark.matrix
def test_two_slow_agents_void_no_race_and_lose_it(tmp_path):
    slow = AGENTS / "hostile" / "slow.py"
    settings = {**SMALL, "races": 1, "max_steps": 80, "race_timeout": 12.0}
    agents = ["heuristic", f"{slow}@:a", f"{slow}@:b"]
    result = run_tournament(agents, output=tmp_path / "cup", **settings)
    assert [race.order[0] for race in result.races] == ["heuristic"]
    assert [row.reason for row in result.standings if row.label in "ab"] == [
        "it has used up its time budget of 3 s for decisions"
    ] * 2


@pytest.mark.slow
def test_no_agent_wins_a_race_in_which_all_agents_failed(tmp_path):
    agents = [str(AGENTS / "hostile" / name) for name in ("unloadable.py", "no_actor.py")]
    result = run_tournament(agents, output=tmp_path, **SMALL | {"races": 3, "per_race": 2})
    first, second = result.standings
    assert first.rating.value == pytest.approx(second.rating.value)
    assert [row.wins for row in result.standings] == [0, 0]
    assert [row.mean_rank for row in result.standings] == [2, 2]
    assert result.ahead == ((0, 0), (0, 0))
    assert result.payoff(0, 1) is None


@pytest.mark.slow
def test_the_command_counts_failures_without_removal_by_race(tmp_path, capsys):
    words = ["--races", "2", "--max-steps", "10", "--track", "lighthouse"]
    words += ["--error-handling", "catch", "--output", str(tmp_path)]
    bad = write_agent(tmp_path, "bad", act="raise KeyError()")
    assert main(["tournament", "ai", bad, *words]) == 3
    (row,) = [row for row in load_tournament(tmp_path).standings if row.label == "bad"]
    assert (row.retired, row.failed, row.errors) == (0, 2, 20)
    shown = capsys.readouterr().out
    assert "2 of 2 races of 2 on lighthouse" in shown
    assert "bad failed in 2 of 2 races: KeyError" in shown
    assert "failed in 2 of 2 races: KeyError" in (tmp_path / "report.html").read_text()
    assert main(["tournament", "--resume", str(tmp_path), "--json"]) == 3
    assert json.loads(capsys.readouterr().out)["standings"][0]["label"] == "ai"


# ------------------------------------------------------------------ interruptions


@pytest.mark.slow
def test_a_resumed_tournament_has_the_same_result_with_another_number_of_jobs(tmp_path):
    whole = run_tournament(THREE, output=tmp_path / "whole", **IN_ONE_PROGRAM | {"jobs": 3})

    class Stop(Exception):
        pass

    def stop(progress):
        if progress.done == 2:
            raise Stop

    before = children_of(os.getpid())
    with pytest.raises(Stop):
        run_tournament(THREE, output=tmp_path / "parts", on_race=stop, **IN_ONE_PROGRAM)
    assert children_of(os.getpid()) == before
    assert len(races_in(tmp_path / "parts")) == 2
    assert run_tournament(THREE, output=tmp_path / "parts", **IN_ONE_PROGRAM) == whole


@pytest.mark.slow
def test_resuming_a_plan_runs_the_agents_that_it_names(tmp_path):
    """Also without a sandbox, if the plan says so."""
    mark, agent, folder = tmp_path / "mark", tmp_path / "stranger", tmp_path / "cup"
    agent.mkdir()
    (agent / "pystk_actor.py").write_text(
        f"open({str(mark)!r}, 'w').close()\n"
        "def get_actor(module_dir, observation_space, action_space):\n"
        "    return lambda state, observation: action_space.sample()\n"
    )
    settings = {name: value for name, value in SMALL.items() if name != "plot"}
    plan = plan_tournament(["ai", str(agent)], **{**settings, "per_race": 2}, sandbox="off")
    folder.mkdir()
    (folder / "plan.json").write_text(plan.to_json())
    assert not mark.exists()
    resume_tournament(folder)
    assert mark.exists()


KILLER = """
import os, re, signal

def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        keeper = open(f"/proc/{os.getppid()}/status").read()
        os.kill(int(re.search(r"PPid:\\s+(\\d+)", keeper)[1]), signal.SIGKILL)
    return actor
"""


@pytest.mark.slow
def test_an_agent_that_ends_its_worker_voids_only_its_races(tmp_path):
    """Without a sandbox, it can. The same command tries these races again."""
    killer = tmp_path / "killer.py"
    killer.write_text(KILLER)
    settings = {**SMALL, "races": 3, "per_race": 2, "sandbox": "off"}
    with pytest.raises(BatchError, match=r"(?s)2 of 3 races.* run agents in a sandbox"):
        run_tournament(["ai", "heuristic", str(killer)], output=tmp_path / "cup", **settings)
    assert len(races_in(tmp_path / "cup")) == 1


@pytest.mark.slow
@pytest.mark.skipif(bool(bubblewrap_problem()), reason=bubblewrap_problem())
def test_an_agent_that_attacks_when_behind_voids_no_race_and_finishes_last(tmp_path):
    loser = write_sore_loser(tmp_path, f"stkzoo-test-{os.getpid()}")
    settings = {**SMALL, "races": 3, "per_race": 2, "max_steps": 60, "sandbox": "on"}
    result = run_tournament(
        [str(AGENTS / "plain"), loser], output=tmp_path / "cup", action_timeout=2.0, **settings
    )
    assert result.is_complete
    assert result.standings[-1].label == "sore loser"
    assert result.sandboxes == ("bubblewrap",)
    assert {"files", "network", "signals"} <= {*result.protections}
    assert all(race.order[-1] == "sore loser" for race in result.races)
    assert sum(row.errors for row in result.standings[:-1]) == 0


@pytest.mark.slow
def test_a_race_that_never_ends_is_ended(tmp_path):
    settings = {**SMALL, "races": 1, "per_race": 2, "max_steps": 10**6, "race_timeout": 1.0}
    with pytest.raises(BatchError, match="it was not over after 1 s"):
        run_tournament(["random", "random@:r"], output=tmp_path / "cup", **settings)


def test_a_race_that_was_late_is_repeated_with_a_time_budget():
    order = RaceOrder(0, ("ai", "random"), RaceSettings(inline=True, time_budget=20.0))
    settings = order.hurried(30.0).settings
    assert (settings.time_budget, settings.inline) == (10.0, False)


@pytest.mark.slow
def test_two_programs_cannot_run_the_same_tournament(tmp_path):
    folder = tmp_path / "cup"

    def again(progress):
        if progress.done == 1:
            with pytest.raises(ConfigError, match="another program works on the tournament"):
                run_tournament(THREE, output=folder, **IN_ONE_PROGRAM)
            heard.append(progress)

    heard = []
    run_tournament(THREE, output=folder, on_race=again, **IN_ONE_PROGRAM)
    assert len(heard) == 1


@pytest.mark.slow
def test_another_tournament_in_the_folder_is_refused(small):
    folder, result, _ = small
    agents = [agent.text for agent in result.plan.agents]
    with pytest.raises(ConfigError, match=r"has another tournament: .*races is 9 and was 4"):
        run_tournament(agents, output=folder, tracks=["lighthouse"], races=9)


@pytest.mark.slow
def test_an_agent_that_changes_between_two_races_is_reported_only_on_resume(tmp_path):
    agent, folder = tmp_path / "mine", tmp_path / "cup"
    shutil.copytree(AGENTS / "plain", agent)

    def change(progress):
        if progress.done == 1:
            (agent / "helper.py").write_text("chase = None")

    settings = {**SMALL, "races": 2, "per_race": 2, "jobs": 1}
    result = run_tournament(["ai", str(agent)], output=folder, on_race=change, **settings)
    assert result.standings[1].errors == 1
    with pytest.raises(ConfigError, match=r"agent 'Plain' have changed: \['mine/helper.py'\]"):
        resume_tournament(folder)
    shutil.rmtree(agent)
    with pytest.raises(ConfigError, match=f"agent 'Plain' is no longer at {agent}"):
        resume_tournament(folder)
    shutil.copytree(AGENTS / "plain", agent)
    (agent / "notes.txt").write_text("new files are ignored")
    assert resume_tournament(folder) == result


def test_a_plan_whose_version_had_another_schedule_is_refused(tmp_path):
    text = plan_tournament(THREE).to_json()
    (tmp_path / "plan.json").write_text(text.replace('"schema_version": 2', '"schema_version": 1'))
    with pytest.raises(ConfigError, match=r"version 1, .* another version of stkzoo wrote it"):
        resume_tournament(tmp_path)


def test_the_fingerprint_of_an_agent_covers_compiled_and_hidden_files(tmp_path):
    shutil.copytree(AGENTS / "plain", tmp_path / "mine")
    for name in ("later.pyc", ".weights", ".data/x", ".git/HEAD", "__pycache__/a.pyc", "a.log"):
        (tmp_path / "mine" / name).parent.mkdir(exist_ok=True)
        (tmp_path / "mine" / name).write_text("")
    assert list(fingerprint(str(tmp_path / "mine"))) == [
        *("mine/helper.py", "mine/later.pyc", "mine/pystk_actor.py"),
        *("mine/.weights", "mine/.data/x"),
    ]


def test_the_fingerprint_of_an_actor_file_covers_its_folder(tmp_path):
    """The file's sandbox contains this folder."""
    shutil.copytree(AGENTS / "plain", tmp_path / "mine")
    files = fingerprint(str(tmp_path / "mine" / "pystk_actor.py"))
    assert list(files) == ["helper.py", "pystk_actor.py"]


def test_the_fingerprint_of_an_agent_covers_a_bounded_amount_of_data(tmp_path, monkeypatch):
    """A link in an agent's folder can name a file without end, such as /proc/self/pagemap."""
    monkeypatch.setattr(batch_agents, "MAX_BYTES", 10_000)
    for name in "ab":
        with (tmp_path / name).open("wb") as file:
            file.truncate(1 << 42)
    (tmp_path / "pystk_actor.py").touch()
    assert [*fingerprint(str(tmp_path)).values()] == [
        hashlib.blake2b(bytes(size), digest_size=8).hexdigest() for size in (10_000, 0, 0)
    ]


@pytest.mark.slow
def test_a_damaged_race_file_is_an_error(small, tmp_path):
    folder = tmp_path / "cup"
    shutil.copytree(small[0], folder)
    first = folder / "races" / "00000.json"
    good = first.read_text()
    first.write_text(good[:100])
    with pytest.raises(ConfigError, match="delete it to run the race again"):
        resume_tournament(folder)
    first.unlink()
    resume_tournament(folder)
    assert (
        RaceResult.load(first).agents[0].distance == RaceResult.from_json(good).agents[0].distance
    )


# ------------------------------------------------------------------ plans and the command


@pytest.mark.parametrize(
    ("agents", "plan", "message"),
    [
        ("ai", {}, "expected a list of at least two"),
        (["ai"], {}, "needs at least two agents, such as my_agent and ai; this one has 1"),
        (["ai", "ai"], {}, "two agents are called 'ai'; give each a different name"),
        (["random@:Ada", "ai@:ADA"], {}, r"'ADA' \(in different case\); give"),
        (["ai", "nobody"], {}, "unknown driver 'nobody'"),
        (["ai:0", "random"], {}, "'ai:0' requires difficulty 0, but the races have difficulty 2"),
        (THREE, {"tracks": ["lighthous"]}, "Did you mean 'lighthouse'"),
        (THREE, {"per_race": 4}, "per_race is 4, expected a whole number from 2 to 3"),
        (THREE, {"error_handling": "raise"}, "choose retire, catch or restart"),
        (THREE, {"lap": 2}, "Did you mean 'laps'"),
    ],
)
def test_invalid_plans_are_refused(agents, plan, message):
    with pytest.raises(ConfigError, match=message):
        plan_tournament(agents, **plan)


def test_an_agent_that_is_named_again_on_resume_does_not_join_twice(tmp_path):
    (tmp_path / "late").mkdir()
    one, two = write_agent(tmp_path, "ada"), write_agent(tmp_path / "late", "ada")
    plan = plan_tournament(["ai", one], tracks=["lighthouse"], races=2)
    for _ in range(3):
        (tmp_path / "plan.json").write_text(plan.to_json())
        plan = resumed_plan(tmp_path, [two, "ai"]).continuing(plan)
        assert [agent.label for agent in plan.agents] == ["ai", "ada", "ada-2"]
        assert plan.additions == (1,)
    renamed = resumed_plan(tmp_path, [f"{two}@:Eve", f"{one}@:ada"]).continuing(plan)
    assert [agent.label for agent in renamed.agents][2:] == ["ada-2", "Eve"]


def test_invalid_usage_exits_with_2(tmp_path, capsys):
    assert main(["tournament", "--resume", str(tmp_path)]) == 2
    assert "has no tournament" in capsys.readouterr().err
