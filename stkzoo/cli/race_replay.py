"""The flags of ``stkzoo race`` for replays."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race import RaceListener

__all__ = ["add_flags", "listeners"]


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags."""
    group = parser.add_argument_group("a replay")
    group.add_argument(
        "--replay",
        metavar="FILE",
        help="keep the race in FILE (.stkz), for `stkzoo replay FILE`",
    )


def listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """What the flags ask for.

    Raises:
        ConfigError: the file cannot be.
    """
    if arguments.replay is None:
        return []
    if arguments.races > 1:
        raise ConfigError("--replay keeps one race; leave out --races")
    from stkzoo.race.replay import ReplayWriter

    return [ReplayWriter(arguments.replay)]
