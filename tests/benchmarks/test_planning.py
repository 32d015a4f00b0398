"""The comparison of the planner with its base policy, with simulated results."""

import json
import sys

import pytest

from benchmarks import planning


@pytest.fixture
def raced(monkeypatch):
    """Replaces races by fixed results; returns the keys of the requested races."""
    keys = []

    def race(*key):
        keys.append(key)
        seconds = 25.0 if key[-1] == "planner" else 30.0
        return planning.Result(*key, seconds, rank=1, rescues=0, seconds=1.0)

    monkeypatch.setattr(planning, "race", race)
    return keys


def compare(monkeypatch, file, *options):
    monkeypatch.setattr(sys, "argv", ["planning", "--output", str(file), *options])
    planning.main()


def test_a_repeated_command_runs_only_the_missing_races(monkeypatch, tmp_path, raced):
    file = tmp_path / "planning.json"
    compare(monkeypatch, file, "--track", "lighthouse")
    compare(monkeypatch, file, "--track", "lighthouse", "hacienda")
    assert [key[0] for key in raced] == ["lighthouse"] * 2 + ["hacienda"] * 2


def test_races_can_be_repeated(monkeypatch, tmp_path, raced):
    for _ in range(2):
        compare(monkeypatch, tmp_path / "planning.json", "--track", "lighthouse", "--again")
    assert len(raced) == 4


def test_the_file_keeps_races_with_and_without_rivals(monkeypatch, tmp_path, raced):
    file = tmp_path / "planning.json"
    for rivals in ("0", "4"):
        compare(monkeypatch, file, "--track", "lighthouse", "--rivals", rivals)
    assert len(json.loads(file.read_text())["races"]) == len(raced) == 4


@pytest.mark.usefixtures("raced")
def test_the_table_shows_the_gain(monkeypatch, tmp_path, capsys):
    compare(monkeypatch, tmp_path / "planning.json", "--track", "lighthouse")
    assert "+0.148" in capsys.readouterr().out
