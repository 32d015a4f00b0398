"""Fuzzes readers of untrusted input with mutated bytes.

``make test-all`` gives each reader 1,000 inputs; to give it more, set ``STKZOO_INPUTS=20000``.
:mod:`tests.chaos.fuzzing` fuzzes a reader guided by coverage.
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

from stkzoo.drivers.files import unpack
from stkzoo.engine.assets.headless import read_archive
from stkzoo.engine.assets.staging import Progress
from stkzoo.env.scenario import Scenario
from stkzoo.errors import AssetError, ConfigError
from stkzoo.evaluation import BenchmarkPlan, TournamentPlan, plan_benchmark, plan_tournament
from stkzoo.race import RaceResult
from stkzoo.race.replay import ReplayError, load_replay
from tests.chaos.cost import feed_measured
from tests.chaos.mutation import mutated
from tests.chaos.targets import TARGETS, Target
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow

#: Number of inputs of each reader in ``make test-all``.
INPUTS = int(os.environ.get("STKZOO_INPUTS", "1000"))


def feed_inputs(name, count):
    """Feeds the initial inputs and many mutated ones to a reader."""
    target = TARGETS[name]
    seeds = target.seeds()
    inputs = itertools.islice(mutated(random.Random(1), seeds), count)
    for data in itertools.chain(seeds, inputs):
        feed_measured(target, data)


@pytest.mark.parametrize(
    ("name", "count"),
    [("messages", 3000), ("agent zips", 300), ("asset archives", 100), ("binary files", 100)],
)
def test_mutated_input_is_read_or_raises_the_readers_own_error(name, count):
    feed_inputs(name, count)


@pytest.mark.matrix
@pytest.mark.timeout(0)
@pytest.mark.parametrize("name", TARGETS)
def test_much_mutated_input_is_read_or_raises_the_readers_own_error(name):
    feed_inputs(name, INPUTS)


@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not here")
def test_atheris_feeds_a_reader(tmp_path):
    command = [sys.executable, "-m", "tests.chaos.fuzzing", "messages", "-runs=500"]
    variables = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=tmp_path, env=variables, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert "Done 500 runs" in done.stderr


def test_an_input_that_takes_much_memory_is_a_finding():
    blocks = []
    target = Target("bad", lambda data: blocks.append(bytes(len(data))), list, lambda n: n // 2)
    with pytest.raises(AssertionError, match="100000 bytes took 100"):
        feed_measured(target, bytes(100_000))


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
