"""Check this machine and suggest fixes.

Checks everything that stkzoo needs or can use, and shows commands that fix problems. Succeeds if
a headless race can run on this machine.

Examples:
  stkzoo doctor           a table
  stkzoo doctor --json    JSON output for programs
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib import metadata
from typing import Any

from stkzoo._imports import python_command
from stkzoo._installation import (
    install_command,
    library_remedy,
    pip_install,
    requirements,
    unmet_requirements,
)
from stkzoo._os import DISPLAY_VARIABLES, display_problem
from stkzoo._temporary import TemporaryFolder
from stkzoo.cli._console import JsonArguments, say, show, show_table
from stkzoo.drivers.sandbox import bubblewrap_problem
from stkzoo.engine.assets import DATADIR_VARIABLE, find_assets
from stkzoo.engine.fork_client import can_fork
from stkzoo.engine.process import engine_environment, explain_os_errors
from stkzoo.engine.render_session import GRAPHICS_PACKAGES, missing_graphics_libraries
from stkzoo.errors import AssetError, ConfigError
from stkzoo.render.encoder import find_ffmpeg

_SANDBOX_REMEDY = "sudo apt install bubblewrap (0.8 or later); see The sandbox in the documentation"

_PROBE = """\
import pystk2
pystk2.init(pystk2.GraphicsConfig.none())
print("tracks:", *pystk2.list_tracks(pystk2.RaceConfig.RaceMode.NORMAL_RACE))
"""

#: Time limit for the engine's start [s], which normally takes 0.5 s.
_PROBE_LIMIT = 60.0


def run(arguments: JsonArguments) -> int:
    """Runs all checks and shows the findings."""
    findings = list(_diagnose())
    ready = all(finding["ok"] for finding in findings if finding["required"])
    report = {"ready": ready, "checks": findings}
    show(report, lambda _: _write_table(findings, ready), as_json=arguments.json)
    return 0 if ready else 1


def _write_table(findings: list[dict[str, Any]], ready: bool) -> None:
    rows, styles = [], []
    for finding in findings:
        is_ok, is_required = finding["ok"], finding["required"]
        verdict = "ok" if is_ok else "missing" if is_required else "without"
        rows.append((verdict, finding["name"], finding["found"]))
        styles.append(None if is_ok else "red" if is_required else "yellow")
    show_table(("", "check", "found"), rows, styles=styles)
    for finding in findings:  # outside the table, where a command would wrap
        if finding["remedy"]:
            say(f"{finding['name']}: {finding['remedy']}")
    say(
        "A headless race can run here."
        if ready
        else "Headless races cannot run here yet; see above."
    )


class NotFound(Exception):
    """A check failed.

    Args:
        problem: what is wrong.
        remedy: the fix; empty for the default fix of the check.
    """

    def __init__(self, problem: str, remedy: str = "") -> None:
        super().__init__(problem)
        self.remedy = remedy


#: Names of the checks without whose features headless races cannot run.
_REQUIRED = ("Python", "libraries", "engine", "race data", "engine starts")


def _diagnose() -> Iterator[dict[str, Any]]:
    """Runs all checks, in the order in which to fix problems.

    Yields:
        ``name``, the checked feature; ``ok``, whether it is available and works; ``found``, what
        was found, or the problem; ``remedy``, the fix, if possible a command, or an empty text;
        ``required``, whether headless races need the feature.
    """
    # The variable overrides installed data, so users must unset it first.
    prefix = f"unset {DATADIR_VARIABLE}; " if os.environ.get(DATADIR_VARIABLE) else ""
    install = f"{prefix}stkzoo assets install"
    (_, required), *extras = requirements().items()
    checks: list[tuple[str, Callable[[], str], str]] = [
        ("Python", _python, "install Python 3.10 or newer"),
        ("libraries", partial(_libraries, required), install_command("")),
        ("engine", _engine, pip_install("PySuperTuxKart2")),
        ("race data", _race_data, install),
        ("engine starts", _start, f"{install} --force"),
        ("headless pack", _pack, f"{prefix}stkzoo assets pack"),
        ("full data", _full_data, install),
        ("fork", _fork, "use Linux"),
        ("sandbox of agents", _sandbox, _SANDBOX_REMEDY),
        ("3D graphics", _graphics, f"sudo apt install {GRAPHICS_PACKAGES}"),
        ("display", _display, "run in a graphical session, or under xvfb-run"),
        ("ffmpeg", _ffmpeg, install_command("races")),
    ]
    for extra, texts in extras:
        if extra != "all":
            check = partial(_libraries, texts)
            checks.append((f"extra [{extra}]", check, install_command(extra)))
    for name, find, remedy in checks:
        finding = {"name": name, "ok": True, "remedy": "", "required": name in _REQUIRED}
        try:
            finding["found"] = find()
        except AssetError as error:
            finding |= {"ok": False, "found": str(error).splitlines()[0], "remedy": install}
        except NotFound as error:
            finding |= {"ok": False, "found": str(error), "remedy": error.remedy or remedy}
        except Exception as error:  # noqa: BLE001 - one failure must not hide the other findings
            finding |= {"ok": False, "found": f"{type(error).__name__}: {error}"}
        yield finding


def _python() -> str:
    return f"{sys.version.split()[0]} ({sys.executable})"


def _engine() -> str:
    _probe("import pystk2", os.environ)
    return f"PySuperTuxKart2 {metadata.version('PySuperTuxKart2')}"


def _race_data() -> str:
    assets = find_assets()
    return f"{len(assets.tracks)} tracks, {len(assets.karts)} karts in {assets.root}"


def _start() -> str:
    assets = find_assets()
    with explain_os_errors(), TemporaryFolder("doctor") as home:
        lines = _probe(_PROBE, engine_environment(assets.root, str(home.path)))
    tracks = {name for line in lines if line.startswith("tracks:") for name in line.split()[1:]}
    if tracks != {*assets.tracks}:
        raise NotFound(f"it sees {len(tracks)} tracks where stkzoo sees {len(assets.tracks)}")
    return f"and sees its {len(assets.tracks)} tracks"


def _probe(program: str, variables: Mapping[str, str]) -> list[str]:
    """Returns the output of a program run in a new process, which the engine may crash.

    Args:
        program: Python code.
        variables: its environment variables.

    Raises:
        NotFound: the program failed.
    """
    try:
        process = subprocess.run(  # noqa: S603 - our own interpreter
            python_command(program),
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=_PROBE_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise NotFound(f"no answer in {_PROBE_LIMIT:.0f} s") from None
    text = process.stdout.decode(errors="replace").strip()
    lines = text.splitlines() or ["it wrote nothing"]
    if process.returncode != 0:
        raise NotFound(f"it ended with {process.returncode}: {lines[-1]}", library_remedy(text))
    return lines


def _pack() -> str:
    if not find_assets().headless:
        raise NotFound("not in use: races start slower")
    return "in use: races start faster"


def _full_data() -> str:
    assets = find_assets(graphics=True)
    return f"{assets.root} ({assets.source})"


def _fork() -> str:
    if not can_fork():
        raise NotFound("each race starts a new game process")
    return "races start in milliseconds"


def _sandbox() -> str:
    if problem := bubblewrap_problem():
        raise NotFound(problem.partition("; ")[0], "" if sys.platform == "linux" else "use Linux")
    return "bubblewrap works"


def _graphics() -> str:
    if sys.platform != "linux":
        return "the system's own"
    if missing := missing_graphics_libraries():
        raise NotFound(f"no {', no '.join(missing)}")
    return "libEGL and libGL"


def _display() -> str:
    if problem := display_problem():
        raise NotFound(f"no live window, pictures and videos only: {problem}")
    named = (f"{name}={os.environ[name]}" for name in DISPLAY_VARIABLES if name in os.environ)
    return " ".join(named) or "the system's own"


def _ffmpeg() -> str:
    try:
        return find_ffmpeg()
    except ConfigError:
        raise NotFound("none: no videos") from None


def _libraries(texts: list[str]) -> str:
    if unmet := list(unmet_requirements(texts)):
        raise NotFound(", ".join(unmet))
    return ", ".join(texts)
