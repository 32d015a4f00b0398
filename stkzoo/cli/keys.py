"""``stkzoo keys``: keys for networked races."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

__all__ = ["add_parser"]

_ABOUT = """\
Keys say who is who in networked races, and encrypt what goes over the network.

Everybody makes a pair of their own. NAME.secret stays where it is; NAME.public is
given to the others.
"""

_EXAMPLES = """\
examples:
  stkzoo keys new ada                   writes ada.secret and ada.public
  stkzoo keys new course --folder keys  the same into another folder
  stkzoo keys show ada.secret           the public half of a secret key
"""


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    parser = subparsers.add_parser(
        "keys",
        help="make keys for networked races",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    deeds = parser.add_subparsers(title="what to do", metavar="DEED", required=True)
    new = deeds.add_parser("new", help="make a pair of keys", description="Makes a pair of keys.")
    new.add_argument("name", metavar="NAME", help="of the two files")
    new.add_argument(
        "--folder", type=Path, default=Path(), metavar="DIR", help="where to (default: here)"
    )
    new.set_defaults(run=_new)
    show = deeds.add_parser(
        "show", help="show the public half of a key", description="Shows a public key."
    )
    show.add_argument("file", type=Path, metavar="FILE", help="a .secret or .public file")
    show.set_defaults(run=_show)


def _new(arguments: argparse.Namespace) -> int:
    from stkzoo.race.remote import new_key_files, read_public

    secret, public = new_key_files(arguments.name, arguments.folder)
    print(f"{secret}  keep it to yourself")
    print(f"{public}  give it to the others; it says: {read_public(public)}")
    return 0


def _show(arguments: argparse.Namespace) -> int:
    from stkzoo.race.remote import read_publics

    for key, name in read_publics([arguments.file]).items():
        print(f"public {key} {name}".rstrip())
    return 0
