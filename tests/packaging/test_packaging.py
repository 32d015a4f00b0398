"""The wheel, the source distribution, and the installed package."""

import os
import re
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

from tests.support.docs_blocks import blocks, shortened
from tests.support.paths import ROOT, copy_checkout

pytestmark = pytest.mark.slow

CONSUMER = '''\
"""Somebody's package that uses stkzoo, strictly typed."""

from stkzoo import AgentSpec, ConfigError, race_v0
from stkzoo.race import run_race
from stkzoo.wrappers.marl import Teams


def drive() -> float:
    env = race_v0.parallel_env(agents=[AgentSpec(name="me")], num_kart=2, track="lighthouse")
    observations, infos = env.reset(seed=1)
    reveal_type(observations)
    reveal_type(env.state())
    return float(infos["kart_0"]["distance"])


def names() -> list[str]:
    result = run_race(["heuristic", "ai"], track="lighthouse", seed=1)
    reveal_type(result.status)
    return [row.driver for row in result.agents]


def fails(error: ConfigError) -> str:
    return str(error)
'''

WRONG = """\
from stkzoo import race_v0

race_v0.parallel_env(num_kart="four")
"""


def run(words, **options):
    done = subprocess.run(words, capture_output=True, text=True, timeout=500, **options)
    return done.returncode, done.stdout + done.stderr


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Builds the source distribution, and a wheel from it; returns their folder."""
    folder = tmp_path_factory.mktemp("dist")
    copy = copy_checkout(tmp_path_factory.mktemp("source") / "stkzoo")
    code, said = run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder)], cwd=copy
    )
    assert code == 0, said[-3000:]
    return folder


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """Installs the wheel in a new environment that uses the tests' packages; returns its Python."""
    folder = tmp_path_factory.mktemp("outside") / "env"
    venv.create(folder, with_pip=False, symlinks=True)
    (site,) = folder.glob("lib/python*/site-packages")
    (wheel,) = built.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(site)
    others = [path for path in sys.path if path.endswith("site-packages")]
    (site / "others.pth").write_text("\n".join(others) + "\n")
    return folder / "bin" / "python"


def test_the_files_pass_the_checks_of_the_index(built):
    files = [str(path) for path in built.iterdir()]
    assert len(files) == 2
    code, said = run([sys.executable, "-m", "twine", "check", "--strict", *files])
    assert code == 0, said
    wheel = next(file for file in files if file.endswith(".whl"))
    checker = Path(sys.executable).parent / "check-wheel-contents"
    code, said = run([str(checker), wheel], cwd=ROOT)
    assert code == 0, said
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        metadata = archive.read(name).decode()
    targets = re.findall(r'(?:\]\(|src=")([^)"]+)', metadata)
    assert len(targets) > 20
    assert [target for target in targets if not target.startswith("https://")] == []


def test_the_source_distribution_has_the_files_for_tests_and_docs(built):
    (source,) = built.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    for name in (
        "LICENSE",
        "CITATION.cff",
        "tests/support/browser.py",
        "tests/data/agents/plain/pystk_actor.py",
        "docs/conf.py",
        "agents/planning/planning.h",
        "stkzoo/kernel/kernel.h",
        "stkzoo/engine/libm.c",
        "stkzoo/py.typed",
        "wrappers/marl/teams.py",
    ):
        assert name in names, name
    assert not [name for name in names if name.endswith((".so", ".pyc"))]


def test_the_wheel_works_outside_the_checkout_without_a_compiler(installed, tmp_path):
    program = f"""
import stkzoo
from stkzoo.engine.process import LIBM, SHORTCUTS
assert "site-packages" in stkzoo.__file__ and "outside" in stkzoo.__file__, stkzoo.__file__
assert LIBM.exists() and SHORTCUTS.exists()
{shortened(blocks("README.md", "python")[0])}"""
    demo = ["-m", "stkzoo", "race", "--demo", "--max-steps", "30"]
    for words in (["-c", program], ["-m", "stkzoo", "doctor"], demo):
        environment = {**os.environ, "PATH": str(tmp_path)}
        code, said = run([str(installed), *words], cwd=tmp_path, env=environment)
        assert code == 0, said
    assert "Next: `stkzoo new" in said


@pytest.mark.matrix
def test_type_checkers_see_the_types_of_the_installed_package(installed, tmp_path):
    (tmp_path / "consumer.py").write_text(CONSUMER)
    (tmp_path / "wrong.py").write_text(WRONG)
    command = [sys.executable, "-m", "mypy", "--strict", "--python-executable", str(installed)]
    code, said = run([*command, "consumer.py", "wrong.py"], cwd=tmp_path)
    for revealed in ("dict[", "ndarray[", "str"):
        assert re.search(rf'Revealed type is ".*{re.escape(revealed)}', said), said
    assert code == 1
    (error,) = re.findall(r"^.*: error: .*", said, re.MULTILINE)
    assert error.startswith("wrong.py:3: error: ")
    assert 'Argument "num_kart" to "RaceParallelEnv" has incompatible type "str"' in error
