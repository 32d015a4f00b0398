"""The flags of ``stkzoo race`` for the live page."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from stkzoo.errors import ConfigError

if TYPE_CHECKING:
    from stkzoo.race import RaceListener

__all__ = ["add_flags", "listeners"]

_SPEEDS = {"1": 1.0, "2": 2.0, "4": 4.0, "max": None}


def add_flags(parser: argparse.ArgumentParser) -> None:
    """Adds the flags."""
    group = parser.add_argument_group("a live page in the browser")
    group.add_argument("--web", action="store_true", help="show the race on a page while it runs")
    group.add_argument(
        "--web-port",
        type=int,
        default=8000,
        metavar="N",
        help="its port; 0 takes a free one (default: %(default)s)",
    )
    group.add_argument(
        "--web-host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="its address; 0.0.0.0 lets other machines watch (default: %(default)s)",
    )
    group.add_argument(
        "--web-speed",
        choices=_SPEEDS,
        default="1",
        help="times real time at the start (default: %(default)s)",
    )
    group.add_argument(
        "--web-wait", action="store_true", help="wait on the grid until a viewer presses Run"
    )
    group.add_argument(
        "--web-stay",
        action="store_true",
        help="keep the page after the race, until Close or Ctrl-C",
    )


def listeners(arguments: argparse.Namespace) -> list[RaceListener]:
    """What the flags ask for.

    Raises:
        ConfigError: a value cannot be, the port is taken, or a library is missing.
    """
    if not arguments.web:
        return []
    if arguments.races > 1 and arguments.web_stay:
        raise ConfigError("--web-stay is for one race; leave out --races")
    from stkzoo.race.web import LivePage

    page = LivePage(
        host=arguments.web_host,
        port=arguments.web_port,
        speed=_SPEEDS[arguments.web_speed],
        paused=arguments.web_wait,
        stay=arguments.web_stay,
    )
    arguments.web_port = page.port  # of the races that follow
    print(f"live page: {page.url}", file=sys.stderr, flush=True)
    return [page]
