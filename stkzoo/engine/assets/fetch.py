"""Downloads of the game's data: the package of Debian or Ubuntu, or the download of ``pystk2``.

The package is downloaded and unpacked, not installed. This needs no root privileges and changes
nothing outside stkzoo's cache. apt downloads package lists to a private folder, because those of
the machine may be missing or out of date. apt checks signatures and checksums.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from email import message_from_string
from pathlib import Path

from stkzoo._imports import python_command
from stkzoo.engine.assets.find import DATADIR_VARIABLE, pystk2_cache_folder
from stkzoo.engine.assets.staging import Progress, fresh_folder, link_or_copy
from stkzoo.engine.assets.tree import ENGINE_DATA_VERSION, check_shape, write_marker
from stkzoo.errors import AssetError

_LOOK_EVERY = 0.1  # [s]


def _run(
    command: Sequence[str],
    *,
    folder: Path,
    watch: Callable[[], None] = lambda: None,
    name: str = "",
    last_lines: int = 8,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Runs a program and waits for its end.

    Args:
        command: the program and its arguments.
        folder: working directory.
        watch: function called every 0.1 s. If it raises an error, the program is killed.
        name: name of the program in error texts; by default, the command.
        last_lines: number of lines of the output in error texts.
        environment: environment variables; by default, those of this process.

    Returns:
        The output of the program.

    Raises:
        AssetError: the program failed; the message has the last lines of its output.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log:
        process = subprocess.Popen(  # noqa: S603 - a fixed program, no shell
            command,
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
        log.seek(0)
        text = log.read()
    if process.returncode != 0:
        name = name or f"`{' '.join(command)}`"
        lines = "\n".join(text.strip().splitlines()[-last_lines:])
        raise AssetError(f"{name} failed ({process.returncode}): {lines}")
    return text


PACKAGE = "supertuxkart-data"

_INSIDE = "usr/share/games/supertuxkart/data"

#: Versions of the data with which races are the same as with the engine's own version.
_KNOWN_VERSIONS = ("1.4", ENGINE_DATA_VERSION)

_SUBSTITUTE_FONTS = ("wqy-microhei.ttf", "SigmarOne.otf")


def fetch_debian(target: Path, work: Path, progress: Progress) -> None:
    """Downloads the package and makes a full tree from it.

    Debian's data differs from what the engine needs in three points: the empty file that names the
    version, the skin ``classic``, and the fonts, which are links to files of other packages. All
    files that affect a race are identical.

    Args:
        target: an empty folder that becomes the root of the tree.
        work: an empty folder for temporary files, on the same disk.
        progress: receives progress reports.

    Raises:
        AssetError: apt is missing or fails, or the data is of another version or incomplete.
    """
    if shutil.which("apt-get") is None or shutil.which("dpkg-deb") is None:
        raise AssetError("this machine has no apt-get and dpkg-deb (it is not Debian or Ubuntu).")
    package = _download(work, progress)
    _unpack(package, target, progress)
    package.unlink()
    data = target / "data"
    _check_version(data)
    (data / f"supertuxkart.{ENGINE_DATA_VERSION}").touch()
    _adapt_skin(data / "skins")
    _adapt_fonts(data / "ttf")
    write_marker(target, package.name, headless=False)


def _private_options(work: Path) -> list[str]:
    """Returns apt options for a private state in ``work``.

    apt still reads the machine's sources and keys.
    """
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


def _download(work: Path, progress: Progress) -> Path:
    """Downloads the package. The machine's package lists may be missing or out of date."""
    options = _private_options(work)
    progress.begin("fetching the package lists")
    try:
        _run(["apt-get", *options, "update"], folder=work)
    except AssetError as error:
        progress.note(f"some package lists could not be fetched ({error})")
    show = ["apt-cache", *options, "show", "--no-all-versions", PACKAGE]
    record = message_from_string(_run(show, folder=work))
    try:
        size = int(record["Size"])
    except (TypeError, ValueError) as error:
        raise AssetError(f"the package lists do not know {PACKAGE} ({error!r}).") from error
    progress.begin(f"downloading {PACKAGE} {record['Version']}", size)
    words = ["apt-get", *options, "download", PACKAGE]
    _run(words, folder=work, watch=lambda: progress.reach(_size_of_packages(work)))
    packages = sorted(work.glob("*.deb"))
    if len(packages) != 1 or packages[0].stat().st_size != size:
        raise AssetError(f"`{' '.join(words)}` downloaded no complete package.")
    progress.reach(size)
    return packages[0]


def _size_of_packages(work: Path) -> int:
    return sum(path.stat().st_size for path in work.glob("*.deb*"))


def _unpack(package: Path, target: Path, progress: Progress) -> None:
    """Unpacks the data folder of a ``.deb`` file into an existing folder."""
    progress.begin(f"unpacking {package.name}")
    file = str(package.absolute())
    with fresh_folder(target, "package") as whole:
        broken = f"{package} cannot be unpacked: dpkg-deb"
        _run(["dpkg-deb", "--extract", file, str(whole)], folder=target, name=broken)
        if not (whole / _INSIDE).is_dir():
            raise AssetError(f"{package} has no files in {_INSIDE}.")
        (whole / _INSIDE).replace(target / "data")


def _check_version(data: Path) -> None:
    if not any((data / f"supertuxkart.{version}").exists() for version in _KNOWN_VERSIONS):
        versions = sorted(path.name for path in data.glob("supertuxkart.*"))
        raise AssetError(
            f"{data} is from another version of the game ({', '.join(versions) or 'not marked'}); "
            f"races need data of {' or '.join(_KNOWN_VERSIONS)}."
        )


def _adapt_skin(skins: Path) -> None:
    classic = skins / "classic"
    if classic.exists():
        return
    others = sorted(path.name for path in skins.iterdir() if (path / "stkskin.xml").exists())
    if not others:
        raise AssetError(f"{skins} has no skin.")
    classic.symlink_to("peach" if "peach" in others else others[0])


def _adapt_fonts(fonts: Path) -> None:
    usable = [fonts / name for name in _SUBSTITUTE_FONTS if (fonts / name).is_file()]
    usable += sorted(path for path in fonts.iterdir() if path.is_file())
    dangling = [path for path in fonts.iterdir() if not path.exists()]
    if dangling and not usable:
        raise AssetError(f"{fonts} has no font.")
    for font in dangling:
        font.unlink()
        link_or_copy(usable[0], font)


_ARCHIVE = f"SuperTuxKart-{ENGINE_DATA_VERSION}-src.tar.gz"

#: Maximum time without progress before a download is stopped [s].
_PATIENCE = 90.0

_PROGRAM = "import pystk2; pystk2.init(pystk2.GraphicsConfig.none())"


def fetch_upstream(work: Path, progress: Progress) -> None:
    """Runs the download of ``pystk2`` to its own cache, in a separate process.

    Args:
        work: working directory of the process.
        progress: receives progress reports.

    Raises:
        AssetError: the download failed, or made no progress for 90 s.
    """
    cache = pystk2_cache_folder()
    cache.mkdir(parents=True, exist_ok=True)
    progress.begin("downloading with pystk2")
    archive = cache / _ARCHIVE
    watch = _Watch(archive, cache / f"{_ARCHIVE}.tmp", progress)
    variables = {name: text for name, text in os.environ.items() if name != DATADIR_VARIABLE}
    try:
        _run(
            python_command(_PROGRAM),
            folder=work,
            watch=watch,
            name="the download of pystk2",
            last_lines=1,
            environment=variables,
        )
    except AssetError:
        archive.unlink(missing_ok=True)  # otherwise pystk2 would use the same broken file again
        raise
    check_shape(cache / ENGINE_DATA_VERSION)


class _Watch:
    """Reports the progress of the download, and raises an error when it stops growing."""

    def __init__(self, archive: Path, growing: Path, progress: Progress) -> None:
        self._archive, self._growing, self._progress = archive, growing, progress
        self._size, self._since = -1, time.monotonic()

    def __call__(self) -> None:
        if self._archive.exists():  # pystk2 unpacks it
            return
        size = self._growing.stat().st_size if self._growing.exists() else 0
        if size != self._size:
            self._size, self._since = size, time.monotonic()
            self._progress.reach(size)
        if time.monotonic() - self._since > _PATIENCE:
            raise AssetError(f"the download of pystk2 made no progress for {_PATIENCE:.0f} s.")
