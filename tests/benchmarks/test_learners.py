"""Which interpreter runs a contender of bench_learners."""

import sys

import pytest

from benchmarks import bench_learners
from benchmarks.ecosystem import SETS


@pytest.fixture
def environments(monkeypatch):
    """The environments that were asked for, by folder; none is made."""
    made = {}

    def environment(folder, packages):
        made[folder] = packages
        return folder / "python"

    monkeypatch.setattr(bench_learners, "environment", environment)
    return made


def test_contenders_without_another_library_run_here(environments, tmp_path):
    assert bench_learners._python("ppo", tmp_path) == sys.executable
    assert environments == {}


def test_a_missing_library_is_installed_in_an_environment(environments, tmp_path, monkeypatch):
    monkeypatch.setitem(bench_learners._LIBRARIES, "rllib", ("no_such_module", "rllib"))
    assert bench_learners._python("rllib", tmp_path) == str(tmp_path / "rllib" / "python")
    assert environments == {tmp_path / "rllib": SETS["rllib"]}


def test_an_installed_library_is_used_as_it_is(environments, tmp_path, monkeypatch):
    monkeypatch.setitem(bench_learners._LIBRARIES, "torchrl", ("json", "main"))
    assert bench_learners._python("torchrl", tmp_path) == sys.executable
    assert environments == {}
