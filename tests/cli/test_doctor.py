import json
import os
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from stkzoo._os import DISPLAY_VARIABLES
from stkzoo.cli import main
from stkzoo.engine.assets import cache_folder
from tests.support.processes import run_program


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


@pytest.fixture
def odd_machine(tmp_path, monkeypatch):
    """Sets up an odd machine: an old Gymnasium, no extra."""
    information = tmp_path / "gymnasium-1.1.1.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: gymnasium\nVersion: 1.1.1\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    needed = {"": ["gymnasium>=1.2", "numpy>=2.0"], "web": ["nothing-like-it>=3"]}
    monkeypatch.setattr("stkzoo.cli.doctor.requirements", lambda: needed)


@pytest.mark.usefixtures("odd_machine")
def test_what_is_odd_about_a_machine_is_named(capsys):
    code, answer, checks = report(capsys)
    assert (code, answer["ready"]) == (1, False)
    assert checks["libraries"]["found"] == "gymnasium 1.1.1 is older than 1.2"
    assert checks["extra [web]"]["found"] == "no nothing-like-it"


def test_a_check_that_fails_itself_is_a_finding(monkeypatch, capsys):
    monkeypatch.setattr("stkzoo.cli.doctor.can_fork", lambda: 1 / 0)
    code, _, checks = report(capsys)
    assert code == 0
    assert checks["fork"]["found"] == "ZeroDivisionError: division by zero"


def test_it_works_beside_an_initialized_engine_with_an_accented_path_in_a_c_locale(tmp_path):
    cache = tmp_path / "cach\u00e9"
    cache.symlink_to(cache_folder())
    code = """
        import pystk2, sys
        from stkzoo.cli import main
        pystk2.init(pystk2.GraphicsConfig.none())
        sys.exit(main(["doctor"]))
    """
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    places = {"STKZOO_CACHE": str(cache), "SUPERTUXKART_DATADIR": str(cache / "headless")}
    done = run_program(code, env={**os.environ, **plain, **places})
    assert done.returncode == 0, done.stderr
    assert "A headless race can run here." in done.stdout
