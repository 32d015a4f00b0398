"""CONTRIBUTING.md's worked examples work, and docs/architecture.md names files that exist."""

import re

import pytest

import stkzoo.cli
from stkzoo.race import run_race
from tests.support.paths import ROOT

PAGE = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def file_of_page(name):
    """Returns the code block that begins with a file's name."""
    (code,) = [block for block in BLOCKS if block.startswith(f"# {name}\n")]
    return code


@pytest.mark.slow
def test_the_view_and_the_reward_term_work():
    code = "\n".join(block for block in BLOCKS if not block.startswith("# "))
    names = {}
    exec(compile(code, "CONTRIBUTING.md", "exec"), names)
    assert names["cautious"].name == "cautious"
    assert "reward/air" in names["infos"]["kart_1"]


@pytest.mark.slow
def test_the_driver_finishes_a_race(tmp_path):
    folder = tmp_path / "steady"
    folder.mkdir()
    (folder / "pystk_actor.py").write_text(file_of_page("steady/pystk_actor.py"))
    result = run_race([str(folder), "ai"], track="lighthouse", seed=1)
    assert result.is_finished
    assert "steady" in {row.driver for row in result.agents}


def test_the_command_is_found_and_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "split.py").write_text(file_of_page("stkzoo/cli/split.py"))
    monkeypatch.setattr(stkzoo.cli, "__path__", [*stkzoo.cli.__path__, str(tmp_path)])
    monkeypatch.setattr(stkzoo.cli, "COMMANDS", (*stkzoo.cli.COMMANDS, "split"))
    assert stkzoo.cli.main(["split", "test"]) == 0
    assert "zengarden" in capsys.readouterr().out.split()


def test_the_diff_for_a_game_mode_matches_the_code():
    (diff,) = re.findall(r"```diff\n(.*?)```", PAGE, re.DOTALL)
    files = re.findall(r"^--- (\S+)\n((?:(?!---)[ +-].*\n)+)", diff, re.MULTILINE)
    assert len(files) == 2
    for name, lines in files:
        source = (ROOT / name).read_text("utf-8").splitlines()
        assert all(line[1:] in source for line in lines.splitlines() if line[0] in " -"), name


def test_the_architecture_page_names_files_that_exist():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    folders = [ROOT, ROOT / "stkzoo", ROOT / "agents"]
    named = set(re.findall(r"`([a-z_/0-9]+\.py|[a-z_]+/[a-z_/]*)`", page))
    assert len(named) > 40
    missing = [n for n in named if not any((folder / n).exists() for folder in folders)]
    assert missing == []
