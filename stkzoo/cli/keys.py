"""Make keys for networked races.

Keys identify the participants of networked races and encrypt the traffic.

Each participant makes a key pair. Keep NAME.secret on your machine, and give NAME.public to the
others.

Examples:
  stkzoo keys new ada                   write ada.secret and ada.public
  stkzoo keys new course --folder keys  write them to another folder
  stkzoo keys show ada.secret           show the public key of a secret key
"""

from __future__ import annotations

import argparse
from pathlib import Path

from stkzoo._arguments import CommandParser
from stkzoo.cli._arguments import add_actions, usage_errors


def add_arguments(parser: CommandParser) -> None:
    """Declares the arguments."""
    new, show = add_actions(parser, _new, _show)
    new.add_argument("name", metavar="NAME", help="name of the two files, without the ending")
    new.add_argument(
        "--folder",
        type=Path,
        default=Path(),
        metavar="FOLDER",
        help="folder of the two files (default: the current one)",
    )
    show.add_argument("file", type=Path, metavar="FILE", help="a .secret or .public file")


@usage_errors
def _new(arguments: argparse.Namespace) -> int:
    """Make a key pair."""
    from stkzoo.race.remote import new_key_files, read_public

    secret, public = new_key_files(arguments.name, arguments.folder)
    print(f"{secret}  keep it secret")
    print(f"{public}  give it to the others; its text: {read_public(public)}")
    return 0


@usage_errors
def _show(arguments: argparse.Namespace) -> int:
    """Show the public key of a key file."""
    from stkzoo.race.remote import read_publics

    for key, name in read_publics([arguments.file]).items():
        print(f"public {key} {name}".rstrip())
    return 0
