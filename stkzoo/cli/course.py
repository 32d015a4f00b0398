"""Create a starter kit for the students of a course.

Writes a folder with stkzoo as a wheel, the game's data for races without 3D graphics, a starter
agent, a notebook and a README.md. Students unpack it and run `sh start`. They need Python and pip,
but no compiler, no checkout and no account. You need the game's data (`stkzoo assets install`).

The wheel is the one from which this copy of stkzoo was installed, or is built from its checkout. It
may need your version of Python and your kind of system; add wheels for others with --wheel.

Examples:
  stkzoo course racing                       make the folder racing
  stkzoo course racing --wheel dist/*.whl    with these wheels
  python -m zipfile -c racing.zip racing     pack it for your students
  stkzoo tournament ai --hand-ins submissions --deadline 2026-12-01T18:00
"""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import distribution
from pathlib import Path

from stkzoo._arguments import option, positional
from stkzoo._imports import python_command
from stkzoo.cli._console import ConsoleProgress
from stkzoo.cli.new import fill, make_empty, write_agent
from stkzoo.engine.assets import pack
from stkzoo.errors import ConfigError

_PIP = "from runpy import run_module; run_module('pip', run_name='__main__')"


@dataclass
class CourseArguments:
    """Arguments of ``stkzoo course``.

    Attributes:
        folder: folder to create
        wheels: wheels of stkzoo, and of other packages that the students need
    """

    folder: str = positional(metavar="FOLDER")
    wheels: tuple[Path, ...] = option((), flag="--wheel", metavar="FILE")


def run(arguments: CourseArguments) -> None:
    """Creates the kit and prints what to do next."""
    folder = make_empty(arguments.folder).resolve()
    with tempfile.TemporaryDirectory(prefix=".stkzoo-", dir=folder) as work:
        kit = Path(work)
        wheels = kit / "wheels"
        wheels.mkdir()
        version = _add_wheels(wheels, arguments.wheels)
        agent = kit / "my_agent"
        agent.mkdir()
        write_agent(agent, agent.name)
        for file in ("README.md", "start", "race.ipynb"):
            fill(f"course-{file}", kit / file, version=version)
        with ConsoleProgress() as progress:
            pack(output=kit / "stk.tar.xz", progress=progress)
        for entry in kit.iterdir():
            entry.rename(folder / entry.name)
    quoted, archive = shlex.quote(arguments.folder), shlex.quote(f"{folder.name}.zip")
    print(f"Created {folder} with stkzoo {version}. Next:")
    print(f"  sh {quoted}/start\n      try it as a student, in a copy of the folder")
    print(f"  python -m zipfile -c {archive} {quoted}\n      pack it for your students")


def _add_wheels(folder: Path, wheels: Sequence[Path]) -> str:
    """Copies wheels to a folder, or lets pip make that of stkzoo; returns the version of stkzoo.

    Raises:
        ConfigError: there is no wheel of stkzoo, or the wheels are of several versions.
    """
    for wheel in wheels:
        shutil.copy(wheel, folder)
    if not wheels:
        package = distribution("stkzoo")
        origin = json.loads(package.read_text("direct_url.json") or "{}").get("url")
        source = origin or f"stkzoo=={package.version}"
        words = ("wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder), source)
        subprocess.run(python_command(_PIP, *words), check=False)  # noqa: S603 - pip
    versions = {wheel.name.split("-")[1] for wheel in folder.glob("stkzoo-*.whl")}
    if len(versions) != 1:
        raise ConfigError(
            f"the kit has wheels of the versions {', '.join(sorted(versions)) or '(none)'} of "
            "stkzoo, expected one version; name its wheels: --wheel stkzoo-*.whl"
        )
    return versions.pop()
