"""Fuzzes readers of untrusted input with mutated bytes.

To run millions of inputs, use ``python -m benchmarks.fuzz``.
"""

import importlib.util
import itertools
import json
import os
import random
import subprocess
import sys
import tarfile
import zipfile

import pytest

from benchmarks import fuzz
from stkzoo.drivers.files import unpack
from stkzoo.engine.assets.headless import read_archive
from stkzoo.engine.assets.staging import Progress
from stkzoo.env.scenario import Scenario
from stkzoo.errors import AssetError, ConfigError
from stkzoo.evaluation import BenchmarkPlan, TournamentPlan, plan_benchmark, plan_tournament
from stkzoo.race import RaceResult
from stkzoo.race.replay import ReplayError, load_replay
from tests.chaos import cost
from tests.chaos.cost import feed_measured
from tests.chaos.mutation import mutated
from tests.chaos.targets import TARGETS, Target

pytestmark = pytest.mark.slow

#: Number of mutated inputs for each reader; fast readers get more.
_INPUTS = dict.fromkeys(TARGETS, 1000) | dict.fromkeys(("messages", "results", "plans"), 3000)


@pytest.mark.parametrize("name", TARGETS)
def test_mutated_input_is_read_or_raises_the_readers_own_error(name):
    target = TARGETS[name]
    seeds = target.seeds()
    inputs = itertools.islice(mutated(random.Random(1), seeds), _INPUTS[name])
    for data in itertools.chain(seeds, inputs):
        feed_measured(target, data)


def test_every_reader_has_a_share_of_a_long_run():
    assert set(fuzz.SHARES) == set(TARGETS)


@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not here")
def test_the_fuzzer_counts_its_inputs(tmp_path):
    words = ["--inputs", "3000", "--readers", "results", "--output", str(tmp_path / "fuzz.json")]
    command = [sys.executable, "-m", "benchmarks.fuzz", *words, "--corpus", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    row = json.loads((tmp_path / "fuzz.json").read_text())["readers"]["results"]
    assert (row["inputs"], row["findings"], row["how"]) == (3000, [], "atheris")


def test_the_fuzzer_saves_the_input_of_a_finding(tmp_path):
    """The fuzzer detects a reader that always raises an unexpected error, and saves the input."""
    code = (
        "import sys; from tests.chaos import targets; from benchmarks import fuzz\n"
        "def bad(data): raise ZeroDivisionError\n"
        "target = targets.TARGETS['results']\n"
        "targets.TARGETS['results'] = targets.Target('results', bad, target.seeds)\n"
        "sys.exit(fuzz.main(sys.argv[1:]))\n"
    )
    corpus = tmp_path / "results"
    (corpus / "found").mkdir(parents=True)
    command = [sys.executable, "-c", code, "--plain", "--feed", "results", "50", "1", str(corpus)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr
    assert list((corpus / "found").iterdir())


def test_an_input_that_takes_much_memory_is_a_finding():
    blocks = []
    target = Target("bad", lambda data: blocks.append(bytes(len(data))), list, lambda n: n // 2)
    with pytest.raises(AssertionError, match="100000 bytes took 100"):
        feed_measured(target, bytes(100_000))


def test_an_input_that_takes_long_is_a_finding(monkeypatch):
    monkeypatch.setattr(cost, "MAX_SECONDS", 0.01)
    target = Target("bad", lambda _: sum(range(1_000_000)), list)
    with pytest.raises(AssertionError, match=r"at most 67108864 bytes and 0\.01 s"):
        feed_measured(target, b"")


# ---------------------------------------------------------------------- earlier findings

DEEP = "[" * 100_000
LONG = '{"a": ' + "9" * 5000 + "}"


@pytest.mark.parametrize("text", [DEEP, LONG, '{"a": 1e999}', '{"a": NaN}'])
@pytest.mark.parametrize(
    "read", [RaceResult.from_json, TournamentPlan.from_json, BenchmarkPlan.from_json]
)
def test_pathological_json_raises_a_config_error(read, text):
    with pytest.raises(ConfigError):
        read(text)


def test_a_plan_with_too_many_races_is_refused():
    tournament = json.loads(plan_tournament(["ai", "heuristic"], tracks=["lighthouse"]).to_json())
    benchmark = json.loads(plan_benchmark("heuristic", split=["lighthouse"], seeds=1).to_json())
    for form, name, read in (
        (tournament, "races", TournamentPlan.from_json),
        (tournament, "per_race", TournamentPlan.from_json),
        (benchmark, "seeds", BenchmarkPlan.from_json),
    ):
        with pytest.raises(ConfigError, match=name):
            read(json.dumps(form | {name: 10**30}))


@pytest.mark.parametrize("name", ["", ".", "data/a\0b"])
def test_an_archive_with_an_invalid_name_is_refused(tmp_path, name):
    file = tmp_path / "pack.tar.xz"
    with tarfile.open(file, "w:xz") as archive:
        archive.addfile(tarfile.TarInfo(name))
    (tmp_path / "target").mkdir()
    with pytest.raises(AssetError):
        read_archive(file, tmp_path / "target", Progress())


def test_a_zip_with_a_nameless_file_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "agent.zip", "w") as archive:
        archive.writestr(".", "print()")
    with pytest.raises(ConfigError, match="leads out of it"):
        unpack(tmp_path / "agent.zip", tmp_path / "home")


def test_a_zip_with_an_undecodable_name_is_refused(tmp_path):
    file = tmp_path / "agent.zip"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("\u00e9.py", "print()")
    file.write_bytes(file.read_bytes().replace("\u00e9".encode(), b"\x83\x83"))
    with pytest.raises(ConfigError, match="not a readable zip"):
        unpack(file, tmp_path / "home")


@pytest.mark.parametrize(
    ("read", "error"), [(load_replay, ReplayError), (Scenario.load, ConfigError)]
)
def test_reading_a_pipe_fails_without_blocking(tmp_path, read, error):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(error):
        read(tmp_path / "pipe")
