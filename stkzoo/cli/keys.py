"""Make keys for networked races.

Keys identify the participants of networked races and encrypt the traffic.

Each participant makes a key pair. Keep NAME.secret on your machine, and give NAME.public to the
others.

Examples:
  stkzoo keys new ada                   write ada.secret and ada.public
  stkzoo keys new course --folder keys  write them to another folder
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from stkzoo._arguments import positional
from stkzoo.race.remote import new_key_files, read_public


@dataclass
class NewKeyArguments:
    """Options of ``stkzoo keys new``.

    Attributes:
        name: name of the two files, without the ending
        folder: folder of the two files (default: the current one)
    """

    name: str = positional()
    folder: Path = Path()


def _new(arguments: NewKeyArguments) -> None:
    """Make a key pair."""
    secret, public = new_key_files(arguments.name, arguments.folder)
    print(f"{secret}  keep it secret")
    print(f"{public}  give it to the others; its text: {read_public(public)}")


ACTIONS = (_new,)
