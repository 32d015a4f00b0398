"""Downloading the game's data: from Debian's or Ubuntu's package, or with ``pystk2``.

The Debian package is downloaded and unpacked, not installed: nothing outside stkzoo's cache
changes, and an ordinary user may do it. Where the machine's package lists are missing or out
of date, apt fetches new ones into a private folder. The apt client checks signatures and
sums.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from email import message_from_string
from pathlib import Path
from typing import Any

from stkzoo.engine.assets.find import DATADIR_VARIABLE, pystk2_cache_folder
from stkzoo.engine.assets.overlay import adapt
from stkzoo.engine.assets.staging import Progress, check_space, fresh_folder
from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, check_files, write_marker
from stkzoo.errors import AssetError

_LOOK_EVERY = 0.1  # [s]
#: Most that a program may write [bytes]; the list of the game's data takes half a megabyte.
_MAX_OUTPUT = 8 << 20


def _run(
    command: Sequence[str],
    *,
    folder: Path,
    watch: Callable[[], None] = lambda: None,
    name: str = "",
    last_lines: int = 8,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Runs a program to its end.

    Args:
        command: the program and its arguments.
        folder: where it runs.
        watch: called a few times a second meanwhile; what it raises ends the program.
        name: what the message calls it; the command itself by default.
        last_lines: how much of its output the message shows.
        environment: variables; ``None`` for our own.

    Returns:
        What it wrote.

    Raises:
        AssetError: it failed; the message carries its last lines.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log:
        process = subprocess.Popen(  # noqa: S603 - a fixed program, no shell
            [*_ending_with_us(), *command],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            while process.poll() is None:
                watch()
                time.sleep(_LOOK_EVERY)
        finally:
            process.kill()
            process.wait()
        size = log.seek(0, os.SEEK_END)
        log.seek(0)
        text = log.read(_MAX_OUTPUT)
    if size > _MAX_OUTPUT:
        raise AssetError(f"{name or command[0]} wrote {size:,} bytes, expected less.")
    if process.returncode != 0:
        name = name or f"`{' '.join(command)}`"
        lines = "\n".join(text.strip().splitlines()[-last_lines:])
        raise AssetError(f"{name} failed ({process.returncode}): {lines}")
    return text


def _ending_with_us() -> list[str]:
    """Command prefix that ends the program when this process is killed, if available."""
    setpriv = shutil.which("setpriv") if os.name == "posix" else None
    return [setpriv, "--pdeathsig", "TERM", "--"] if setpriv else []


PACKAGE = "supertuxkart-data"

_INSIDE = "usr/share/games/supertuxkart/data"


def fetch_debian(target: Path, work: Path, progress: Progress) -> None:
    """Downloads the package and makes a full tree of it.

    Args:
        target: an empty folder, which becomes the tree's root.
        work: an empty folder for what is needed meanwhile, on the same disk.
        progress: receives the progress.

    Raises:
        AssetError: there is no apt client, it fails, or the disk has no room.
    """
    if shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None:
        raise AssetError("this machine has no apt-get and dpkg-deb (it is not Debian or Ubuntu).")
    package = _download(work, progress)
    unpack_package(package, target, progress)
    package.unlink()
    adapt(target / "data")
    check_files(target)
    write_marker(target, package.name, headless=False)


def _download(work: Path, progress: Progress) -> Path:
    """Uses the machine's own package lists if they work, else new ones."""
    try:
        return _download_with([], work, progress)
    except AssetError as error:
        progress.note(f"the machine's package lists do not work; fetching new ones ({error})")
    options = _private_options(work)
    progress.begin("fetching the package lists")
    try:
        _apt("apt-get", *options, "update", folder=work)
    except AssetError as error:
        progress.note(f"some package lists could not be fetched ({error})")
    return _download_with(options, work, progress)


def _private_options(work: Path) -> list[str]:
    """Makes apt keep its state in ``work`` and read the machine's sources and keys."""
    state, cache = work / "apt-state", work / "apt-cache"
    (state / "lists" / "partial").mkdir(parents=True, exist_ok=True)
    (cache / "archives" / "partial").mkdir(parents=True, exist_ok=True)
    settings = {
        "Dir::State": state,
        "Dir::State::lists": state / "lists",
        "Dir::State::status": "/var/lib/dpkg/status",
        "Dir::Cache": cache,
        "Dir::Cache::archives": cache / "archives",
        "APT::Sandbox::User": "root",
    }
    return [word for name, value in settings.items() for word in ("-o", f"{name}={value}")]


def _apt(program: str, *words: str, **options: Any) -> str:
    """Runs one of apt's programs."""
    variables = {**os.environ, "LC_ALL": "C", "DEBIAN_FRONTEND": "noninteractive"}
    return _run([program, *words], environment=variables, **options)


def _download_with(options: list[str], work: Path, progress: Progress) -> Path:
    shown = _apt("apt-cache", *options, "show", "--no-all-versions", PACKAGE, folder=work)
    record = message_from_string(shown)
    try:
        size, unpacked = int(record["Size"]), 1024 * int(record["Installed-Size"])
    except (TypeError, ValueError) as error:
        raise AssetError(f"the package lists do not know {PACKAGE} ({error!r}).") from error
    check_space(work, size + unpacked + 150_000_000, "the game's data")
    for old in work.glob("*.deb"):
        old.unlink()
    progress.begin(f"downloading {PACKAGE} {record['Version']}", size)
    words = ["apt-get", *options, "-o", "APT::Sandbox::User=root", "download", PACKAGE]
    _apt(*words, folder=work, watch=lambda: progress.reach(_size_of_packages(work)))
    found = sorted(work.glob("*.deb"))
    if len(found) != 1 or found[0].stat().st_size != size:
        raise AssetError(f"`{' '.join(words)}` downloaded no complete package.")
    progress.reach(size)
    return found[0]


def _size_of_packages(work: Path) -> int:
    return sum(path.stat().st_size for path in work.glob("*.deb*"))


def unpack_package(package: Path, target: Path, progress: Progress) -> None:
    """Unpacks the data folder of a ``.deb`` file and checks it against its own list.

    Args:
        package: the file.
        target: an existing folder that gets ``data``.
        progress: receives the progress.

    Raises:
        AssetError: the package is broken or holds other content.
    """
    progress.begin(f"unpacking {package.name}")
    file = str(package.absolute())
    with fresh_folder(target, "package") as whole:
        broken = f"{package} cannot be unpacked: dpkg-deb"
        _run(["dpkg-deb", "--extract", file, str(whole)], folder=target, name=broken)
        sums = _run(["dpkg-deb", "--info", file, "md5sums"], folder=target, name=broken)
        (whole / "md5sums").write_text(sums, encoding="utf-8")
        wrong = f"{package} unpacked to wrong or missing files: md5sum"
        _run(["md5sum", "--check", "--quiet", "md5sums"], folder=whole, name=wrong)
        if not (whole / _INSIDE).is_dir():
            raise AssetError(f"{package} holds no files in {_INSIDE}.")
        (whole / _INSIDE).replace(target / "data")


_ARCHIVE = f"SuperTuxKart-{ENGINE_DATA_VERSION}-src.tar.gz"

#: Room for the archive and what it holds [bytes].
_NEEDED = 1_800_000_000

#: A download without progress for this long is stopped [s].
_PATIENCE = 90.0

_PROGRAM = "import pystk2; pystk2.init(pystk2.GraphicsConfig.none())"


def fetch_upstream(work: Path, progress: Progress) -> Path:
    """Makes ``pystk2`` download its data into its own cache, in a separate process.

    Args:
        work: a folder to run in.
        progress: receives the progress.

    Returns:
        The tree's root.

    Raises:
        AssetError: it failed, or made no progress for a minute and a half.
    """
    cache = pystk2_cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    check_space(cache, _NEEDED, "the game's data")
    progress.begin("downloading with pystk2")
    archive = cache / _ARCHIVE
    watch = _Watch(archive, cache / f"{_ARCHIVE}.tmp", progress)
    variables = {name: text for name, text in os.environ.items() if name != DATADIR_VARIABLE}
    try:
        _run(
            [sys.executable, "-c", _PROGRAM],
            folder=work,
            watch=watch,
            name="the download of pystk2",
            last_lines=1,
            environment=variables,
        )
    except AssetError:
        archive.unlink(missing_ok=True)  # pystk2 would try the same broken file again
        raise
    root = cache / ENGINE_DATA_VERSION
    check_files(root)
    return root


class _Watch:
    """Reports the growing download; raises when it no longer grows."""

    def __init__(self, archive: Path, growing: Path, progress: Progress) -> None:
        self._archive, self._growing, self._progress = archive, growing, progress
        self._size, self._since = -1, time.monotonic()
        self._unpacking = False

    def __call__(self) -> None:
        if self._archive.exists():
            if not self._unpacking:
                self._progress.begin("unpacking with pystk2")
            self._unpacking = True
            return
        size = self._growing.stat().st_size if self._growing.exists() else 0
        if size != self._size:
            self._size, self._since = size, time.monotonic()
            self._progress.reach(size)
        if not self._unpacking and time.monotonic() - self._since > _PATIENCE:
            raise AssetError(f"the download of pystk2 made no progress for {_PATIENCE:.0f} s.")
