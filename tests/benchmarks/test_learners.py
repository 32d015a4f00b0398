"""The interpreter of each contender of bench_learners, and the saved results."""

import json
import sys

import pytest

from benchmarks import bench_learners
from benchmarks.ecosystem import SETS


@pytest.fixture
def environments(monkeypatch):
    """Replaces the creation of environments; returns the packages requested for each folder."""
    made = {}

    def environment(folder, packages):
        made[folder] = packages
        return folder / "python"

    monkeypatch.setattr(bench_learners, "environment", environment)
    return made


def test_contenders_without_another_library_use_this_interpreter(environments, tmp_path):
    assert bench_learners._python("ppo", tmp_path) == sys.executable
    assert environments == {}


def test_a_missing_library_is_installed_in_a_new_environment(environments, tmp_path, monkeypatch):
    monkeypatch.setitem(bench_learners._LIBRARIES, "rllib", ("no_such_module", "rllib"))
    assert bench_learners._python("rllib", tmp_path) == str(tmp_path / "rllib" / "python")
    assert environments == {tmp_path / "rllib": SETS["rllib"]}


def test_an_installed_library_is_not_installed_again(environments, tmp_path, monkeypatch):
    monkeypatch.setitem(bench_learners._LIBRARIES, "torchrl", ("json", "main"))
    assert bench_learners._python("torchrl", tmp_path) == sys.executable
    assert environments == {}


def test_saved_results_contain_no_paths_of_this_machine(monkeypatch, tmp_path):
    monkeypatch.setattr(bench_learners, "_measure", lambda *_: {"rate": 2.0})
    output = tmp_path / "learners.json"
    words = ["--only", "ppo", "--rounds", "1", "--folder", str(tmp_path), "--output", str(output)]
    assert bench_learners.main(words) == 0
    assert str(tmp_path) not in output.read_text()
    (result,) = json.loads(output.read_text())["results"]
    assert result["kart_steps_per_second_per_core"]["median"] == 2.0


def test_races_per_core_are_multiplied_by_the_cores(monkeypatch, tmp_path):
    monkeypatch.setattr(bench_learners, "_measure", lambda *_: {"rate": 2.0})
    output = tmp_path / "learners.json"
    words = ["--only", "ppo", "--rounds", "1", "--races", "4", "--per-core", "--cores", "1", "16"]
    assert bench_learners.main([*words, "--output", str(output)]) == 0
    report = json.loads(output.read_text())
    assert [(result["cores"], result["races"]) for result in report["results"]] == [
        (1, 4),
        (16, 64),
    ]
    assert "--per-core --" in report["command"]
