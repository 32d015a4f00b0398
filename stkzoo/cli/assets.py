"""Find, get and pack the game's tracks and karts.

Besides the engine, races need the game's data: 21 tracks and 16 karts. stkzoo searches for it in
this order:

  1. the folder in the environment variable SUPERTUXKART_DATADIR
  2. stkzoo's cache (the environment variable STKZOO_CACHE sets its folder):
     the headless pack, then the full data
  3. the cache of pystk2

The headless pack has no textures, music or sound. Races with it are bit-identical and
faster; drawing needs the full data. Only `stkzoo assets install` downloads anything.

Examples:
  stkzoo assets status                       show the data on this machine
  stkzoo assets install                      from the first source that works
  stkzoo assets install --source debian      from the Debian or Ubuntu package
  stkzoo assets install --source upstream    with the download of pystk2
  stkzoo assets install --from pack.tar.xz   from the pack of another machine
  stkzoo assets pack                         build the pack in the cache
  stkzoo assets pack --output pack.tar.xz    write it to a file of about 32 MB
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stkzoo._arguments import option
from stkzoo.cli._console import ConsoleProgress, megabytes, show_table
from stkzoo.engine import assets


@dataclass
class StatusArguments:
    """Options of ``stkzoo assets status``: none."""


@dataclass
class InstallArguments:
    """Options of ``stkzoo assets install``.

    Attributes:
        source: source of the data; auto takes the first that works
        archive: install the headless pack from FILE, written by `stkzoo assets pack --output`
        replace: replace existing data
    """

    source: str = option("auto", choices=("auto", "debian", "upstream"), rivals="source")
    archive: Path | None = option(flag="--from", metavar="FILE", rivals="source")
    replace: bool = option(False, flag="--force")


@dataclass
class PackArguments:
    """Options of ``stkzoo assets pack``.

    Attributes:
        output: write the pack into FILE, a .tar.xz
        replace: replace an existing pack
    """

    output: Path | None = option(metavar="FILE")
    replace: bool = option(False, flag="--force")


def _status(arguments: StatusArguments) -> None:  # noqa: ARG001 - it has no options
    """Show where the data is.

    Shows where stkzoo searches for the game's data and what it finds. Fails if headless races
    cannot run.
    """
    rows = []
    for report in assets.survey():
        size = megabytes(report.measure()) if report.assets else ""
        rows.append((report.source, str(report.path), _describe(report), size))
    show_table(("place", "folder", "what is there", "size"), rows, title="The game's data")
    used = assets.find_assets()
    print(f"Headless races use the {used.source}: {used.root}")


def _describe(report: assets.PlaceReport) -> str:
    if report.assets is None:
        return report.problem or "nothing"
    contents = "headless pack" if report.assets.headless else "full data"
    return f"{contents}: {len(report.assets.tracks)} tracks, {len(report.assets.karts)} karts"


def _install(arguments: InstallArguments) -> None:
    """Install the data, with a download if needed.

    Uses the data on this machine or downloads it, and builds the headless pack. The download is
    about 630 MB. It needs 2 GB of disk space temporarily, and 750 MB afterwards. Administrator
    rights are not needed. You can interrupt and repeat this command, and run it several times at
    once.

    Examples:
      stkzoo assets install                      from the first source that works
      stkzoo assets install --source debian      from the Debian or Ubuntu package
      stkzoo assets install --source upstream    with the download of pystk2
      stkzoo assets install --from pack.tar.xz   from the pack of another machine
    """
    with ConsoleProgress() as progress:
        new = assets.install(**vars(arguments), progress=progress)
    print(f"Ready: {len(new.tracks)} tracks and {len(new.karts)} karts in {new.root}")


def _pack(arguments: PackArguments) -> None:
    """Build the headless pack, or write it to a file.

    Builds the headless pack from the full data.
    """
    with ConsoleProgress() as progress:
        path = assets.pack(**vars(arguments), progress=progress)
    print(f"Ready: {path}")


ACTIONS = (_status, _install, _pack)
