"""``stkzoo assets``: the game's tracks and karts on this machine."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.engine.assets import PlaceReport

__all__ = ["add_parser"]

_RAW = argparse.RawDescriptionHelpFormatter

_ABOUT = """\
The game's data is what races need beside the engine: 21 tracks and 16 karts. It is
looked for in this order:

  1. the folder in the environment variable SUPERTUXKART_DATADIR
  2. stkzoo's own cache (moved by the environment variable STKZOO_CACHE):
     the headless pack, then the full data
  3. the cache of pystk2
  4. an installed game (/usr/share/games/supertuxkart)

The headless pack has no real pictures, music or sound. Races in it are bit for bit
the same and start faster; drawing needs the full data. Nothing is ever downloaded but
by `stkzoo assets install`.
"""

_INSTALL = """\
Takes the data that is there, or gets it (about 630 MB to download; 1.5 GB of disk
meanwhile, 750 MB after) and builds the headless pack. No administrator's rights are
needed. It may be interrupted and repeated, and several may run at once.
"""

_INSTALL_EXAMPLES = """\
examples:
  stkzoo assets install                      whatever works
  stkzoo assets install --source debian      from Debian's or Ubuntu's package
  stkzoo assets install --source upstream    by the download of pystk2
  stkzoo assets install --from pack.tar.xz   no network: from another machine's pack
"""

_PACK_EXAMPLES = """\
examples:
  stkzoo assets pack                         build it in the cache
  stkzoo assets pack --output pack.tar.xz    and write it into a file (about 40 MB), for
                                             `stkzoo assets install --from` elsewhere
"""


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    parser = subparsers.add_parser(
        "assets",
        help="find, get and pack the game's tracks and karts",
        description=_ABOUT,
        formatter_class=_RAW,
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    _add_status(actions)
    _add_install(actions)
    _add_pack(actions)
    _add_clean(actions)


def _add_status(actions: argparse._SubParsersAction[Any]) -> None:
    status = actions.add_parser(
        "status",
        help="show the places and what is in them",
        description="Shows where the game's data is looked for and what is found there. "
        "Fails if a headless race cannot be run.",
    )
    status.add_argument("--names", action="store_true", help="list the tracks and karts by name")
    status.set_defaults(run=_status)


def _add_install(actions: argparse._SubParsersAction[Any]) -> None:
    install = actions.add_parser(
        "install",
        help="make the data usable: take what is there, get what is not",
        description=_INSTALL,
        epilog=_INSTALL_EXAMPLES,
        formatter_class=_RAW,
    )
    way = install.add_mutually_exclusive_group()
    way.add_argument(
        "--source",
        choices=("auto", "debian", "upstream"),
        default="auto",
        help="where to get it (default: %(default)s, the first that works)",
    )
    way.add_argument(
        "--from",
        dest="archive",
        type=Path,
        metavar="FILE",
        help="take the headless pack from FILE, written by `stkzoo assets pack --output`",
    )
    install.add_argument("--force", action="store_true", help="get anew what is there")
    install.set_defaults(run=_install)


def _add_pack(actions: argparse._SubParsersAction[Any]) -> None:
    pack = actions.add_parser(
        "pack",
        help="build the headless pack, or write it into a file",
        description="Builds the headless pack from the full data.",
        epilog=_PACK_EXAMPLES,
        formatter_class=_RAW,
    )
    pack.add_argument("--output", type=Path, metavar="FILE", help="a .tar.xz file to write")
    pack.add_argument("--force", action="store_true", help="build it anew if it is there")
    pack.set_defaults(run=_pack)


def _add_clean(actions: argparse._SubParsersAction[Any]) -> None:
    clean = actions.add_parser(
        "clean",
        help="remove what stkzoo has put into its cache",
        description="Removes the full data, the headless pack and the links to an installed "
        "game from stkzoo's cache. Nothing outside is touched.",
    )
    clean.add_argument("--yes", action="store_true", help="do not ask")
    clean.set_defaults(run=_clean)


def _status(arguments: argparse.Namespace) -> int:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from stkzoo.cli.console import megabytes
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
    from stkzoo.cli.console import ConsoleProgress
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
    from stkzoo.cli.console import ConsoleProgress
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
        print(f"There was nothing of stkzoo's in {cache_folder()}.")
    return 0


def _agreed(question: str) -> bool:
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        return False
