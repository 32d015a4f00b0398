import json
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from stkzoo._os import DISPLAY_VARIABLES
from stkzoo.cli import main


@pytest.fixture
def no_data(tmp_path, monkeypatch):
    """Sets up a machine without the game's data."""
    monkeypatch.setenv("STKZOO_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other caches"))
    monkeypatch.delenv("SUPERTUXKART_DATADIR", raising=False)


def report(capsys):
    code = main(["doctor", "--json"])
    answer = json.loads(capsys.readouterr().out)
    return code, answer, {check["name"]: check for check in answer["checks"]}


def test_a_race_can_run_without_optional_parts(monkeypatch, capsys):
    why = "bubblewrap does not work here (no permission); it needs version 0.8"
    monkeypatch.setattr("stkzoo.cli.doctor.bubblewrap_problem", lambda: why)
    for name in DISPLAY_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    code, answer, checks = report(capsys)
    assert (code, answer["ready"]) == (0, True)
    assert checks["engine starts"]["found"] == "and sees its 21 tracks"
    assert not checks["display"]["ok"]
    sandbox = checks["sandbox of agents"]
    assert not sandbox["ok"]
    assert sandbox["found"] == "bubblewrap does not work here (no permission)"
    assert sandbox["remedy"]


@pytest.mark.usefixtures("no_data")
def test_fails_without_data_and_names_the_remedy(capsys):
    code, answer, checks = report(capsys)
    assert (code, answer["ready"]) == (1, False)
    assert checks["race data"]["remedy"] == "stkzoo assets install"


@pytest.fixture
def no_library(tmp_path, monkeypatch):
    """Sets up a machine without a library of the engine: a copy of the engine needs libglib-9."""
    engine = Path(find_spec("pystk2").origin)
    shutil.copy(engine, tmp_path)
    (tmp_path / "pysupertuxkart2.libs").mkdir()
    for library in (engine.parent / "pysupertuxkart2.libs").iterdir():
        code = library.read_bytes().replace(b"libglib-2.0.so.0\0", b"libglib-9.0.so.0\0")
        (tmp_path / "pysupertuxkart2.libs" / library.name).write_bytes(code)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


@pytest.mark.skipif(sys.platform != "linux", reason="the names of libraries are those of Linux")
@pytest.mark.usefixtures("no_library")
def test_a_library_that_the_system_lacks_is_named_with_its_remedy(capsys):
    code, _, checks = report(capsys)
    assert code == 1
    remedy = "install your system's package with libglib-9.0.so.0"
    assert checks["engine"]["remedy"] == checks["engine starts"]["remedy"] == remedy


def test_table_ends_with_the_verdict(capsys):
    assert main(["doctor"]) == 0
    assert capsys.readouterr().out.strip().endswith("A headless race can run here.")
