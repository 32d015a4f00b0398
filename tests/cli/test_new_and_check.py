"""The commands ``stkzoo new`` and ``stkzoo check``."""

import errno
import json
import os
import re
import zipfile

import pytest

from stkzoo.cli import main
from stkzoo.evaluation import check_agent
from stkzoo.race import run_race
from tests.support.paths import AGENTS

HOSTILE = AGENTS / "hostile"


@pytest.fixture
def starter(tmp_path):
    folder = tmp_path / "my agent"
    assert main(["new", str(folder)]) == 0
    return folder


def test_the_starter_agent_finishes_lighthouse(starter):
    (row,) = run_race([str(starter)], track="lighthouse", seed=1).agents
    assert row.status == "finished"
    assert (row.driver, row.num_errors, row.num_clipped) == ("my agent", 0, 0)


def test_the_starter_of_another_view_acts_in_that_view(tmp_path, capsys):
    folder = tmp_path / "racer"
    assert main(["new", str(folder), "--view", "racing"]) == 0
    assert main(["check", str(folder), "--max-steps", "5"]) == 0
    assert main(["new", str(tmp_path / "other"), "--view", "racin"]) == 2
    assert "Did you mean 'racing'?" in capsys.readouterr().err


def test_new_refuses_a_view_with_pictures(tmp_path, capsys):
    assert main(["new", str(tmp_path / "seer"), "--view", "camera"]) == 2
    assert "has pictures, which drivers do not get" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_new_prints_the_next_commands(tmp_path, capsys):
    folder = tmp_path / "first"
    assert main(["new", str(folder)]) == 0
    shown = capsys.readouterr().out
    assert f"stkzoo race {folder} ai ai" in shown
    assert f"stkzoo check {folder}" in shown
    assert f"python -m zipfile -c first.zip {folder}" in shown


def test_new_does_not_overwrite(starter, capsys):
    before = (starter / "pystk_actor.py").read_bytes()
    assert main(["new", str(starter)]) == 2
    assert "is not empty; choose another folder" in capsys.readouterr().err
    assert (starter / "pystk_actor.py").read_bytes() == before


def test_new_refuses_a_path_that_is_a_file(tmp_path, capsys):
    (tmp_path / "taken").touch()
    assert main(["new", str(tmp_path / "taken")]) == 2
    assert "cannot create" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["heuristic", "ai", "random", "ai:7", "pretrained:apex", "a@:b"])
def test_new_refuses_names_that_mean_other_drivers(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", name]) == 2
    assert "choose another folder" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [b"caf\xe9", b"a\x1b[31mred", "a\u2028b".encode()])
def test_new_refuses_a_name_that_is_not_plain_text(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", os.fsdecode(name)]) == 2
    error = capsys.readouterr().err
    assert "has control codes or is not UTF-8; choose another folder" in error
    assert error.isascii()
    assert not list(tmp_path.iterdir())


def test_new_reports_a_folder_without_write_permission(tmp_path, monkeypatch, capsys):
    def refuse(path, *arguments, **options):
        if str(path).startswith(str(tmp_path)):
            raise PermissionError(errno.EACCES, "Permission denied")
        return os_open(path, *arguments, **options)

    os_open = os.open
    monkeypatch.setattr(os, "open", refuse)  # root may write everywhere
    assert main(["new", str(tmp_path)]) == 2
    assert "Permission denied" in capsys.readouterr().err


def test_check_measures_a_zip(starter, tmp_path, capsys):
    path = tmp_path / "handed_in.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for file in starter.iterdir():
            archive.write(file, f"folder/{file.name}")
    capsys.readouterr()
    assert main(["check", str(path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["passed"]
    assert report["reason"] == ""
    assert report["steps"] == 50
    assert report["num_files"] == 2
    assert report["size"] == sum(file.stat().st_size for file in starter.iterdir())
    times = report["thinking_time"]
    assert 0 < times["mean"] <= times["max"]
    assert 0 < times["p95"] <= times["max"]


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


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("broken.zip", "is not a readable zip"),
        ("empty.zip", "has no pystk_actor.py in it"),
        ("empty", "has no pystk_actor.py"),
        ("notes.txt", "is another kind of file"),
    ],
)
def test_check_rejects_files_that_are_no_agent(name, reason, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").touch()
    (tmp_path / "broken.zip").write_bytes(b"PK\x03\x04 but not really")
    with zipfile.ZipFile(tmp_path / "empty.zip", "w") as archive:
        archive.writestr("notes.txt", "")
    assert main(["check", str(tmp_path / name)]) == 3
    assert re.search(f"FAIL: .*{reason}", capsys.readouterr().out)


def test_the_name_of_a_damaged_zip_cannot_control_the_terminal(tmp_path, capsys):
    file = tmp_path / "mine\x1b]0;gone\x07\x1b[2J.zip"
    file.write_bytes(b"PK\x03\x04 but not really")
    assert main(["check", str(file)]) == 3
    shown = capsys.readouterr().out
    assert shown.startswith("mine.zip: ")
    assert not {"\x1b", "\x07"} & {*shown}


def test_a_check_uses_the_adapter(tmp_path):
    (tmp_path / "agent.py").write_text("def get_actor(): return lambda: action\naction = 0\n")
    adapter = tmp_path / "adapter.py"
    adapter.write_text(
        "def create_actor(get_actor, module_dir, observation_space, action_space):\n"
        "    return lambda state, observation: action_space.sample()\n"
    )
    report = check_agent(str(tmp_path / "agent.py"), adapter=str(adapter), max_steps=3)
    assert (report.passed, report.steps) == (True, 3)
