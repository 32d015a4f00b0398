"""``stkzoo league``: players that learn against each other's past selves."""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Any

__all__ = ["add_parser"]

_EXAMPLES = """\
examples:
  stkzoo league --output leagues/first --total-timesteps 2000000
  stkzoo league --output leagues/first --total-timesteps 4000000     continue
  stkzoo league --help                                               all options
"""

#: By name, as drivers are found: the package stands above none of its agents.
_LEAGUE = "stkzoo.agents.training.league.league"


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command, which leaves its words to the league's own parser."""
    parser = subparsers.add_parser(
        "league",
        help="let players learn against each other, and rate them",
        description="Players learn in turns against each other's past selves, and are rated.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        add_help=False,
        prefix_chars="\0",  # no word is an option here
    )
    parser.add_argument("words", nargs="*")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    return int(import_module(_LEAGUE).main(arguments.words))
