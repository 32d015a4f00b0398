"""What agents can read in their sandboxes."""

import os
import re
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from stkzoo.drivers import confinement, sandbox
from stkzoo.drivers.files import find_files
from stkzoo.race import run_race
from tests.support.paths import AGENTS, ROOT

needs_bubblewrap = pytest.mark.skipif(
    bool(sandbox.bubblewrap_problem()), reason=sandbox.bubblewrap_problem()
)
needs_landlock = pytest.mark.skipif(not confinement.landlock_version(), reason="needs Landlock")
BOTH = [
    pytest.param(sandbox.BUBBLEWRAP, marks=needs_bubblewrap),
    pytest.param(sandbox.LANDLOCK, marks=needs_landlock),
]


def readable(source):
    """Returns the paths that the sandbox of an agent contains."""
    with ExitStack() as life:
        place = find_files(str(source)).place(life)
        enclosure = sandbox.enclose("auto", place, None, life)
    command = enclosure.command
    mounted = [command[i + 1] for i, word in enumerate(command) if word.endswith(("bind", "-try"))]
    return [*mounted, *enclosure.confinement.readable]


@pytest.fixture(params=BOTH)
def project(request, tmp_path, monkeypatch):
    """Makes the current folder a project with an agent, a rival, libraries and its packages."""
    monkeypatch.setattr(sandbox, "sandbox_kind", lambda _: request.param)
    folder = tmp_path / "project"
    packages = tmp_path / "site-packages"
    for name in ("agent/pystk_actor.py", "rivals/one.py", "library.so", "src/code.py"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    packages.mkdir()
    (packages / "editable.pth").write_text(f"{folder}\n{folder / 'src'}\n")
    (packages / "linked").symlink_to(folder)
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "site-packages").symlink_to(folder)
    monkeypatch.chdir(folder)
    monkeypatch.setattr("sys.path", [*sys.path, str(packages)])
    return folder


LEAKS = {
    "an editable installation": lambda _: None,
    "an empty library path": lambda patch: patch.setenv("LD_LIBRARY_PATH", ":/lib:"),
    "a relative library path": lambda patch: patch.setenv("LD_LIBRARY_PATH", ".:rivals:../project"),
    "a folder with libraries": lambda patch: patch.setenv("LD_LIBRARY_PATH", os.getcwd()),
    "the root as library path": lambda patch: patch.setenv("LD_LIBRARY_PATH", "/"),
    "a module search path": lambda patch: patch.syspath_prepend(os.getcwd()),
    "an interactive session": lambda patch: patch.syspath_prepend(""),
    "a path that leaves the packages": lambda patch: patch.syspath_prepend(
        os.path.abspath("../site-packages") + "/../project"
    ),
    "a link with the name of packages": lambda patch: patch.syspath_prepend(
        os.path.abspath("../link/site-packages")
    ),
    "a virtual environment in the project": lambda patch: patch.setattr("sys.prefix", os.getcwd()),
}


@pytest.mark.parametrize("leak", LEAKS.values(), ids=LEAKS)
def test_an_agent_reads_only_python_its_packages_and_itself(project, monkeypatch, leak):
    leak(monkeypatch)
    paths = [os.path.realpath(path) for path in readable(project / "agent")]
    assert str(project / "agent") in paths
    secrets = (project / "rivals" / "one.py", project / "src" / "code.py", Path.home() / ".ssh")
    for secret in secrets:
        assert [path for path in paths if secret.is_relative_to(path)] == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", BOTH)
def test_an_agent_gets_exactly_the_environment_variables_on_its_page(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(sandbox, "sandbox_kind", lambda _: kind)
    for name in ("LANG", "LC_ALL", "LC_CTYPE", "TZ", "LD_LIBRARY_PATH", "SECRET"):
        monkeypatch.setenv(name, "C")
    agent = "text = open('/proc/self/environ').read()\nraise ValueError(text.replace('\\0', ' '))"
    (tmp_path / "pystk_actor.py").write_text(agent)
    (row,) = run_race([tmp_path], track="lighthouse", max_steps=1).agents
    page = (ROOT / "docs/reference/agents.md").read_text("utf-8")
    listed = {*re.findall(r"`(\w+)`", re.search(r"\| environment variables \|.*", page)[0])}
    gets = {*re.findall(r"(\w+)=", row.errors[0].message)}
    assert gets | {"PWD"} == listed


def test_an_agent_reads_the_libraries_of_a_named_folder(project, monkeypatch):
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{project}:/lib")
    assert str(project / "library.so") in readable(project / "agent")


@needs_bubblewrap
def test_linked_packages_are_mounted_where_they_are(tmp_path, monkeypatch):
    """A link in a mount would lead nowhere."""
    shared = tmp_path / "shared" / "site-packages"
    (tmp_path / "venv" / "lib").mkdir(parents=True)
    shared.mkdir(parents=True)
    (tmp_path / "venv" / "lib" / "site-packages").symlink_to(shared)
    monkeypatch.setattr("sys.prefix", str(tmp_path / "venv"))
    monkeypatch.syspath_prepend(tmp_path / "venv" / "lib" / "site-packages")
    assert {str(tmp_path / "venv" / "lib"), str(shared)} <= {*readable(AGENTS / "plain")}
    sandbox.bubblewrap_problem.cache_clear()
    assert sandbox.bubblewrap_problem() == ""


@pytest.mark.slow
@needs_bubblewrap
def test_a_relative_or_linked_interpreter_does_not_weaken_the_sandbox(tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "linked").symlink_to(sys.prefix)
    code = f"""if True:
        from stkzoo.race import run_race
        result = run_race([{str(AGENTS / "plain")!r}], track="lighthouse", max_steps=3)
        print(result.sandbox, result.agents[0].errors)
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    for python in ("../linked/bin", os.path.relpath(sys.prefix + "/bin", tmp_path / "here")):
        program = os.path.join(python, os.path.basename(sys.executable))
        done = subprocess.run(
            [program, "-c", code],
            cwd=tmp_path / "here",
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.stdout == "bubblewrap ()\n", done.stderr
