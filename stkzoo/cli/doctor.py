"""Check this machine and suggest fixes.

Checks everything that stkzoo needs or can use, and names the command that fixes what is missing.
Succeeds if a headless race can run here.
"""

from __future__ import annotations

import argparse
import ctypes.util
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import asdict, dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from stkzoo.engine.assets import DATADIR_VARIABLE, Assets, find_assets
from stkzoo.errors import AssetError
from stkzoo.kernel import IS_COMPILED

EXAMPLES = """\
examples:
  stkzoo doctor           a table
  stkzoo doctor --json    the same for programs
"""

_GRAPHICS_REMEDY = "sudo apt install libegl1 libgl1 libgl1-mesa-dri"

_PROBE = """\
import pystk2
pystk2.init(pystk2.GraphicsConfig.none())
print("tracks:", *pystk2.list_tracks(pystk2.RaceConfig.RaceMode.NORMAL_RACE))
"""

#: The engine starts in half a second; after this time it hangs [s].
_PROBE_LIMIT = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments."""
    parser.add_argument("--json", action="store_true", help="write JSON instead of a table")


def run(arguments: argparse.Namespace) -> int:
    """Runs all checks and shows their findings."""
    findings = _diagnose()
    ready = all(finding.ok for finding in findings if finding.required)
    if arguments.json:
        report = {"ready": ready, "checks": [asdict(finding) for finding in findings]}
        print(json.dumps(report, indent=2))
    else:
        _write_table(findings, ready)
    return 0 if ready else 1


def _write_table(findings: list[Finding], ready: bool) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    table = Table("", "check")
    table.add_column("found", overflow="fold")
    table.add_column("remedy", overflow="fold")
    for finding in findings:
        verdict = "ok" if finding.ok else "missing" if finding.required else "without"
        colour = "green" if finding.ok else "red" if finding.required else "yellow"
        remedy = "" if finding.ok else finding.remedy
        texts = (Text(text) for text in (finding.name, finding.found, remedy))
        table.add_row(Text(verdict, colour), *texts)
    console.print(table)
    last = "A headless race can run here." if ready else "No race can run here yet: see above."
    console.print(last)


@dataclass(frozen=True)
class Finding:
    """The outcome of one check.

    Attributes:
        name: what was checked.
        ok: whether it is available and works.
        found: what was found, or the problem.
        remedy: the fix, a command where there is one.
        required: whether headless races need it.
    """

    name: str
    ok: bool
    found: str
    remedy: str = ""
    required: bool = False


def _diagnose() -> list[Finding]:
    """Runs all checks, in the order in which you would fix things."""
    data, assets = _check_race_data()
    return [
        _check_python(),
        _check_engine(),
        data,
        _check_start(assets),
        _check_pack(assets),
        _check_full_data(),
        _check_fork(),
        _check_kernel(),
        _check_graphics(),
        _check_display(),
        _check_ffmpeg(),
        *_check_extras(),
    ]


def _check_python() -> Finding:
    found = f"{sys.version.split()[0]} ({sys.executable})"
    ok = sys.version_info >= (3, 10)
    return Finding("Python", ok, found, "install Python 3.10 or newer", required=True)


def _check_engine() -> Finding:
    remedy = "pip install PySuperTuxKart2"
    try:
        version = metadata.version("PySuperTuxKart2")
    except metadata.PackageNotFoundError:
        return Finding("engine", False, "PySuperTuxKart2 is not installed", remedy, required=True)
    code, text = _probe("import pystk2", {})
    if code != 0:
        return Finding("engine", False, _last_line(text), remedy, required=True)
    return Finding("engine", True, f"PySuperTuxKart2 {version}", required=True)


def _check_race_data() -> tuple[Finding, Assets | None]:
    try:
        assets = find_assets()
    except AssetError as error:
        remedy = _data_remedy("stkzoo assets install")
        return Finding("race data", False, str(error), remedy, required=True), None
    found = f"{len(assets.tracks)} tracks, {len(assets.karts)} karts in {assets.root}"
    return Finding("race data", True, found, required=True), assets


def _data_remedy(command: str) -> str:
    """The command that fixes the data; a variable that overrides it is unset first."""
    return f"unset {DATADIR_VARIABLE}; {command}" if os.environ.get(DATADIR_VARIABLE) else command


def _check_start(assets: Assets | None) -> Finding:
    name = "engine starts"
    if assets is None:
        remedy = _data_remedy("stkzoo assets install")
        return Finding(name, False, "not tried: no data", remedy, required=True)
    remedy = _data_remedy("stkzoo assets install --force")
    code, text = _probe(_PROBE, {DATADIR_VARIABLE: str(assets.root)})
    lines = [line.split()[1:] for line in text.splitlines() if line.startswith("tracks:")]
    if code != 0 or not lines:
        found = f"it ended with {code}: {_last_line(text)}"
        return Finding(name, False, found, remedy, required=True)
    if tuple(sorted(lines[-1])) != assets.tracks:
        found = f"it sees {len(lines[-1])} tracks where stkzoo sees {len(assets.tracks)}"
        return Finding(name, False, found, remedy, required=True)
    return Finding(name, True, f"and sees its {len(assets.tracks)} tracks", required=True)


def _probe(program: str, variables: dict[str, str]) -> tuple[int, str]:
    """Exit code and output of a small program: the engine may crash its process."""
    try:
        process = subprocess.run(  # noqa: S603 - our own interpreter
            [sys.executable, "-c", program],
            env={**os.environ, **variables},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=_PROBE_LIMIT,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return 1, f"no answer in {_PROBE_LIMIT:.0f} s"
    return process.returncode, process.stdout.decode(errors="replace")


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1] if lines else "it wrote nothing"


def _check_pack(assets: Assets | None) -> Finding:
    ok = assets is not None and assets.headless
    found = "in use: races start faster" if ok else "not in use: races start slower"
    return Finding("headless pack", ok, found, _data_remedy("stkzoo assets pack"))


def _check_full_data() -> Finding:
    try:
        assets = find_assets(graphics=True)
    except AssetError as error:
        remedy = _data_remedy("stkzoo assets install")
        return Finding("full data", False, str(error).splitlines()[0], remedy)
    return Finding("full data", True, f"{assets.root} ({assets.source})")


def _check_fork() -> Finding:
    ok = hasattr(os, "fork") and sys.platform.startswith("linux")
    found = "races start in milliseconds" if ok else "each race starts a new game process"
    return Finding("fork", ok, found, "use Linux")


def _check_kernel() -> Finding:
    if os.environ.get("STKZOO_KERNEL") == "off":
        return Finding("kernel", False, "turned off: numpy does its work", "unset STKZOO_KERNEL")
    found = "compiled" if IS_COMPILED else "not compiled: a step costs more"
    remedy = "install a C compiler and Python's headers (python3-dev), then stkzoo again"
    return Finding("kernel", IS_COMPILED, found, remedy)


def _check_graphics() -> Finding:
    name = "3D graphics"
    if not sys.platform.startswith("linux"):
        return Finding(name, True, "the system's own")
    missing = [name for name in ("EGL", "GL") if ctypes.util.find_library(name) is None]
    drivers = _graphics_drivers()
    if missing or not drivers:
        wanted = [f"lib{name}" for name in missing] + ([] if drivers else ["a Mesa driver"])
        return Finding(name, False, f"no {', no '.join(wanted)}", _GRAPHICS_REMEDY)
    return Finding(name, True, "libEGL, libGL and a driver")


def _graphics_drivers() -> list[Path]:
    folders = (Path("/usr/lib"), Path("/usr/lib64"), Path("/usr/local/lib"))
    patterns = ("dri/*_dri.so", "*/dri/*_dri.so", "libnvidia-eglcore*", "*/libnvidia-eglcore*")
    return [path for folder in folders for pattern in patterns for path in folder.glob(pattern)]


def _check_display() -> Finding:
    name = "display"
    if not sys.platform.startswith("linux"):
        return Finding(name, True, "the system's own")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        if os.environ.get(variable):
            return Finding(name, True, f"{variable}={os.environ[variable]}")
    found = "none: no live window, pictures and videos only"
    return Finding(name, False, found, "run in a graphical session, or under xvfb-run")


def _check_ffmpeg() -> Finding:
    path = shutil.which("ffmpeg")
    if path is not None:
        return Finding("ffmpeg", True, path)
    if find_spec("imageio_ffmpeg") is not None:
        return Finding("ffmpeg", True, "the one in imageio-ffmpeg")
    return Finding("ffmpeg", False, "none: no videos", 'pip install "stkzoo[record]"')


def _check_extras() -> list[Finding]:
    """One finding per optional extra that stkzoo's own metadata declares."""
    return [
        _check_extra(extra, names)
        for extra, names in _extras().items()
        if extra not in ("all", "dev", "docs")
    ]


def _extras() -> dict[str, list[str]]:
    extras: dict[str, list[str]] = {}
    for requirement in metadata.requires("stkzoo") or ():
        name = re.match(r"[\w.-]+", requirement)
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", requirement)
        if name and extra:
            extras.setdefault(extra[1], []).append(name[0])
    return extras


def _check_extra(extra: str, names: list[str]) -> Finding:
    missing = [name for name in names if not _has_distribution(name)]
    found = f"no {', no '.join(missing)}" if missing else ", ".join(names)
    return Finding(f"extra [{extra}]", not missing, found, f'pip install "stkzoo[{extra}]"')


def _has_distribution(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True
