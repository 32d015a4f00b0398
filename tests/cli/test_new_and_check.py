"""The commands ``stkzoo new`` and ``stkzoo check``."""

import json
import zipfile

import pytest

from stkzoo.cli import _console, main
from stkzoo.race import run_race
from stkzoo.tracks import SPLITS
from tests.support.paths import AGENTS
from tests.support.views import marked

HOSTILE = AGENTS / "hostile"


@pytest.fixture
def starter(tmp_path):
    folder = tmp_path / "my agent"
    assert main(["new", str(folder)]) == 0
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("track", marked(SPLITS["train"], ["olivermath"]))
def test_the_starter_agent_finishes_every_training_track(track, starter):
    (row,) = run_race([str(starter)], track=track, seed=1, max_steps=2000).agents
    assert row.status == "finished"
    assert (row.driver, row.num_errors, row.num_clipped) == ("my agent", 0, 0)


@pytest.mark.slow
def test_the_starter_of_another_view_acts_in_that_view(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_console, "_QUIET_INTERVAL", 0.0)  # a line for each step
    folder = tmp_path / "racer"
    assert main(["new", str(folder), "--view", "racing"]) == 0
    assert main(["check", str(folder), "--max-steps", "5"]) == 0
    assert "checking the agent: 1 step\nchecking the agent: 2 steps" in capsys.readouterr().err
    actor = folder / "pystk_actor.py"
    actor.write_text(actor.read_text("utf-8").replace("racing-v0", "racing-v1"), "utf-8")
    assert main(["check", str(folder)]) == 3
    shown = capsys.readouterr().out
    assert "unknown env_name 'supertuxkart/racing-v1'. Known: supertuxkart/racing-v0" in shown
    assert main(["new", str(tmp_path / "other"), "--view", "racin"]) == 2
    assert "Did you mean 'racing'?" in capsys.readouterr().err


def test_new_does_not_overwrite(starter, capsys):
    before = (starter / "pystk_actor.py").read_bytes()
    assert b": https://" in before
    assert main(["new", str(starter)]) == 2
    assert "is not empty; choose another folder" in capsys.readouterr().err
    assert (starter / "pystk_actor.py").read_bytes() == before


@pytest.mark.parametrize("name", ["heuristic", "ai", "random", "ai:7", "pretrained:apex", "a@:b"])
def test_new_refuses_names_that_mean_other_drivers(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 2
    assert "choose another folder" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_check_measures_a_zip(starter, tmp_path, capsys):
    path = tmp_path / "handed_in.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for file in starter.iterdir():
            archive.write(file, f"folder/{file.name}")
    capsys.readouterr()
    assert main(["check", str(path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert (report["passed"], report["reason"], report["steps"]) == (True, "", 50)
    times = report["thinking_time"]
    assert 0 < times["mean"] <= times["max"]
    assert 0 < times["p99"] <= times["max"]


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("unloadable", "failed while loading: RuntimeError: not today"),
        ("exits", "failed at step 0: its process exited with code 1"),
    ],
)
def test_check_says_why_an_agent_fails(name, reason, capsys):
    assert main(["check", str(HOSTILE / f"{name}.py")]) == 3
    shown = capsys.readouterr().out
    assert f"FAIL: {reason}" in shown
    assert "PASS" not in shown


@pytest.mark.parametrize(
    ("agent", "expected"),
    [("heuristic", "name your own agent"), ("no/such/agent", "expected a folder")],
)
def test_check_refuses_drivers_without_files(agent, expected, capsys):
    assert main(["check", agent]) == 2
    assert expected in capsys.readouterr().err


def test_the_name_of_a_damaged_zip_cannot_control_the_terminal(tmp_path, capsys):
    file = tmp_path / "mine\x1b]0;gone\x07\x1b[2J.zip"
    file.write_bytes(b"PK\x03\x04 but not really")
    assert main(["check", str(file)]) == 3
    shown = capsys.readouterr().out
    assert shown.startswith("mine.zip: ")
    assert not {"\x1b", "\x07"} & {*shown}
