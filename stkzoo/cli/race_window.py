"""The flags of ``stkzoo race`` for the game's own window."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.race import RaceListener

__all__ = ["add_flags", "listeners"]


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags."""
    group = parser.add_argument_group("the game's window")
    choice = group.add_mutually_exclusive_group()
    choice.add_argument("--window", action="store_true", help="watch the race in the game")
    choice.add_argument("--hide", action="store_true", help="open no window (the default)")


def listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """What the flags ask for."""
    if not arguments.window:
        return []
    from stkzoo.race import RaceListener

    class Window(RaceListener):
        def env_options(self) -> dict[str, Any]:
            return {"render_mode": "human"}

    return [Window()]
