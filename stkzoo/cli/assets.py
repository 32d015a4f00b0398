"""Find, get and pack the game's tracks and karts.

Besides the engine, races need the game's data: 21 tracks and 16 karts. stkzoo looks for it in this
order:

  1. the folder in the environment variable SUPERTUXKART_DATADIR
  2. stkzoo's own cache (moved by the environment variable STKZOO_CACHE):
     the headless pack, then the full data
  3. the cache of pystk2
  4. an installed game (/usr/share/games/supertuxkart)

The headless pack has no textures, music or sound. Races with it are bit-identical and start
faster; drawing needs the full data. Only `stkzoo assets install` downloads anything.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stkzoo.engine.assets import PlaceReport

EXAMPLES = """\
examples:
  stkzoo assets status                       what is on this machine
  stkzoo assets install                      any source that works
  stkzoo assets install --source debian      from Debian's or Ubuntu's package
  stkzoo assets install --source upstream    by the download of pystk2
  stkzoo assets install --from pack.tar.xz   no network: from another machine's pack
  stkzoo assets pack                         build the pack in the cache
  stkzoo assets pack --output pack.tar.xz    and write it into a file (about 40 MB), for
                                             `stkzoo assets install --from` elsewhere
"""

_INSTALL = """\
Uses the data on this machine, or downloads it (about 630 MB to download; 1.5 GB of disk
meanwhile, 750 MB after) and builds the headless pack. No administrator's rights are needed. You
may interrupt and repeat it; several may run at once.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the arguments."""
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    status = actions.add_parser(
        "status",
        help="show where the data is",
        description="Shows where stkzoo looks for the game's data and what it finds. Fails if a "
        "headless race cannot run.",
    )
    status.add_argument("--names", action="store_true", help="list the tracks and karts by name")
    status.set_defaults(action=_status)
    install = actions.add_parser(
        "install",
        help="make the data usable; download it if needed",
        description=_INSTALL,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    source = install.add_mutually_exclusive_group()
    source.add_argument(
        "--source",
        choices=("auto", "debian", "upstream"),
        default="auto",
        help="where to get it (default: %(default)s, the first that works)",
    )
    source.add_argument(
        "--from",
        dest="archive",
        type=Path,
        metavar="FILE",
        help="take the headless pack from FILE, written by `stkzoo assets pack --output`",
    )
    install.add_argument("--force", action="store_true", help="replace existing data")
    install.set_defaults(action=_install)
    pack = actions.add_parser(
        "pack",
        help="build the headless pack, or write it into a file",
        description="Builds the headless pack from the full data.",
    )
    pack.add_argument("--output", type=Path, metavar="FILE", help="a .tar.xz file to write")
    pack.add_argument("--force", action="store_true", help="replace an existing pack")
    pack.set_defaults(action=_pack)
    clean = actions.add_parser(
        "clean",
        help="remove stkzoo's data from its cache",
        description="Removes the full data, the headless pack and the links to an installed "
        "game from stkzoo's cache. Nothing outside is touched.",
    )
    clean.add_argument("--yes", action="store_true", help="do not ask")
    clean.set_defaults(action=_clean)


def run(arguments: argparse.Namespace) -> int:
    """Shows, installs, packs or removes the data."""
    return int(arguments.action(arguments))


def _status(arguments: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from stkzoo.cli._console import megabytes
    from stkzoo.engine.assets import find_assets, survey

    table = Table("place", title="The game's data")
    table.add_column("folder", overflow="fold")
    table.add_column("what is there", overflow="fold")
    table.add_column("size", justify="right", no_wrap=True)
    for report in survey():
        size = megabytes(report.measure()) if report.assets else ""
        texts = (report.source, str(report.path), _describe(report), size)
        table.add_row(*map(Text, texts))
    Console().print(table)
    assets = find_assets()
    print(f"Headless races use the {assets.source}: {assets.root}")
    if arguments.names:
        print(f"Tracks: {', '.join(assets.tracks)}")
        print(f"Karts: {', '.join(assets.karts)}")
    return 0


def _describe(report: PlaceReport) -> str:
    if report.assets is None:
        return report.problem or "nothing"
    kind = "headless pack" if report.assets.headless else "full data"
    return f"{kind}: {len(report.assets.tracks)} tracks, {len(report.assets.karts)} karts"


def _install(arguments: argparse.Namespace) -> int:
    from stkzoo.cli._console import ConsoleProgress
    from stkzoo.engine.assets import install

    with ConsoleProgress() as progress:
        assets = install(
            source=arguments.source,
            archive=arguments.archive,
            replace=arguments.force,
            progress=progress,
        )
    print(f"Ready: {len(assets.tracks)} tracks and {len(assets.karts)} karts in {assets.root}")
    return 0


def _pack(arguments: argparse.Namespace) -> int:
    from stkzoo.cli._console import ConsoleProgress
    from stkzoo.engine.assets import pack

    with ConsoleProgress() as progress:
        path = pack(output=arguments.output, replace=arguments.force, progress=progress)
    print(f"Ready: {path}")
    return 0


def _clean(arguments: argparse.Namespace) -> int:
    from stkzoo.engine.assets import cache_folder, clean

    if not arguments.yes and not _agreed(f"Remove stkzoo's data from {cache_folder()}? [y/N] "):
        print("Nothing was removed.")
        return 1
    removed = clean()
    for folder in removed:
        print(f"Removed {folder}")
    if not removed:
        print(f"No data of stkzoo in {cache_folder()}.")
    return 0


def _agreed(question: str) -> bool:
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        return False
