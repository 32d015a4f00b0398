"""The command ``stkzoo race``."""

import json
import shutil

import jsonschema
import pytest

from stkzoo.cli import main
from stkzoo.race import RaceResult
from stkzoo.race.replay import load_replay
from stkzoo.race.runner import _RaceRun
from tests.support.paths import AGENTS, SCHEMAS

SCHEMA = SCHEMAS / "race-result.schema.json"


@pytest.mark.slow
def test_the_command_exits_with_3_if_an_agent_fails(capsys, tmp_path):
    """D27: the reference exits with 0."""
    file = tmp_path / "result.json"
    words = ["race", "ai", str(AGENTS / "hostile" / "exits.py"), "--track", "olivermath"]
    assert main([*words, "--max-steps", "5", "--output", str(file)]) == 3
    assert "exits (kart_1) failed at step 0: its process exited" in capsys.readouterr().out
    assert RaceResult.from_json(file.read_text()).has_errors


@pytest.mark.slow
def test_raise_shows_the_agents_traceback_and_exits_with_3(capsys):
    words = ["race", "ai", str(AGENTS / "hostile" / "once.py"), "--track", "olivermath"]
    assert main([*words, "--error-handling", "raise"]) == 3
    shown = capsys.readouterr().err
    assert 'raise ZeroDivisionError("the third")' in shown


@pytest.mark.slow
def test_several_races_are_summarized(capsys, tmp_path):
    file = tmp_path / "results.json"
    words = ["race", "heuristic", "ai", "--track", "olivermath", "--seed", "5", "--races", "2"]
    assert main([*words, "--max-steps", "20", "--output", str(file)]) == 0
    assert "2 races, seeds 5 to 6: olivermath" in capsys.readouterr().out
    written = json.loads(file.read_text())
    jsonschema.validate(written, json.loads(SCHEMA.read_text()))
    assert [race["seed"] for race in written["races"]] == [5, 6]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143)])
def test_an_interrupted_race_saves_its_result_so_far(tmp_path, name, code, run_command):
    (tmp_path / "pystk_actor.py").write_text(
        "def get_actor(folder, _, space):\n"
        "    def act(state, observation):\n"
        "        (folder / 'driving').touch()\n"
        "        return space.sample()\n"
        "    return act\n"
    )
    words = "race . --max-steps 1000000 --output race.json --replay race.stkz --video race.mp4"
    words += " --render-backend map"
    words += " --sandbox off"  # so that the agent can write into its folder
    interrupt = f"""
        from tests.support.processes import wait_until
        def interrupt():
            wait_until(lambda: os.path.exists("driving"), 60)
            os.kill(os.getpid(), signal.{name})
        threading.Thread(target=interrupt).start()
    """
    done = run_command(words.split(), tmp_path, interrupt)
    assert done.returncode == code
    assert "interrupted; the last race is incomplete" in done.stderr
    assert "Traceback" not in done.stderr
    result = RaceResult.from_json((tmp_path / "race.json").read_text())
    assert result.status == "interrupted"
    replay = load_replay(tmp_path / "race.stkz")
    assert replay.is_partial
    assert result.steps - replay.steps in (0, 1)  # it may come before the last step is saved
    assert (tmp_path / "race.mp4").exists()
    assert not list(tmp_path.glob(".*.part"))


def test_an_interrupt_before_a_race_starts_keeps_the_races_before_it(tmp_path, capsys, monkeypatch):
    file, start, starts = tmp_path / "results.json", _RaceRun._start, []

    def interrupted(race):
        starts.append(race)
        if len(starts) == 3:
            raise KeyboardInterrupt
        start(race)

    monkeypatch.setattr(_RaceRun, "_start", interrupted)
    words = ["race", "ai", "--track", "olivermath", "--races", "9", "--seed", "5"]
    assert main([*words, "--max-steps", "2", "--output", str(file)]) == 130
    assert [race["seed"] for race in json.loads(file.read_text())["races"]] == [5, 6]
    assert "interrupted; complete races: 2" in capsys.readouterr().err


@pytest.mark.slow
def test_command_shows_the_race(capsys):
    assert main(["race", "heuristic", "ai", "--track", "olivermath", "--seed", "1"]) == 0
    shown = capsys.readouterr().out
    assert "olivermath: 1 lap" in shown
    assert [line.split()[0] for line in shown.splitlines()[2:4]] == ["1", "2"]


@pytest.mark.slow
def test_demo_says_where_to_go_next(capsys):
    assert main(["race", "--demo", "--track", "olivermath"]) == 0
    assert "Next: `stkzoo new my_agent`" in capsys.readouterr().out


@pytest.mark.slow
def test_command_writes_only_json_to_stdout_on_request(capsys):
    assert main(["race", "ai", "--track", "olivermath", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["track"] == "olivermath"


@pytest.mark.slow
def test_an_agents_output_is_not_in_the_json(capfd, tmp_path):
    agent = tmp_path / "loud"
    shutil.copytree(AGENTS / "plain", agent)
    with (agent / "pystk_actor.py").open("a") as module:
        module.write("import os\nprint('at load')\nos.write(1, b'by a library')\n")
    words = ["--inline", "--track", "olivermath", "--max-steps", "2", "--json"]
    assert main(["race", str(agent), *words]) == 0
    printed = capfd.readouterr()
    assert json.loads(printed.out)["steps"] == 2
    assert "at load" in printed.err
    assert "by a library" in printed.err


def test_command_adds_bots_to_fill_the_race(capsys):
    words = ["race", "heuristic", "--num-karts", "3", "--track", "olivermath", "--json"]
    assert main(words) == 0
    drivers = [row["driver"] for row in json.loads(capsys.readouterr().out)["agents"]]
    assert sorted(drivers) == ["ai", "ai", "heuristic"]


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["nobody"],
        ["--demo", "ai"],
        ["ai", "ai", "--num-karts", "1"],
        ["ai", "--track", "nowhere"],
        ["ai", "--laps", "0"],
        ["ai", "--seed", "-1"],
        ["no/such/agent.zip"],
        ["ai", "--cameras", "2"],
        ["ai", "--width", "99"],
        ["ai", "--web-port", "8001"],
        ["ai", "--replay", "race.stkz", "--output", "race.stkz"],
    ],
)
def test_invalid_usage_exits_with_2(words, capsys):
    assert main(["race", *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith("stkzoo race: ")
    assert said.count("\n") <= 2  # the second line may list the valid names


def test_command_without_the_games_data_exits_with_1(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("SUPERTUXKART_DATADIR", str(tmp_path))
    assert main(["race", "ai"]) == 1
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "name"), [("--output", "a.json"), ("--replay", "a.stkz"), ("--video", "a.mp4")]
)
@pytest.mark.parametrize("folder", ["missing", "."])
def test_an_unwritable_path_is_refused_before_the_race(option, name, folder, tmp_path, capsys):
    file = tmp_path / folder / name
    if folder == ".":
        file.mkdir()
    assert main(["race", "ai", option, str(file)]) == 2  # after the race, it would be 1
    said = capsys.readouterr()
    assert "cannot be written" in said.err
    assert said.out == ""
