"""Train players against each other, and rate them.

Players learn in turns against each other's past selves, and are rated.

Examples:
  stkzoo league --output leagues/first --total-timesteps 2000000
  stkzoo league --output leagues/first --total-timesteps 4000000     continue
  stkzoo league --help                                               all options
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module

from stkzoo._arguments import positional

#: The league has its own parser, so this parser must not interpret any argument as an option.
PARSER_OPTIONS = {"add_help": False, "prefix_chars": "\0"}

#: The module is imported by name, because the package must not depend on its agents.
_LEAGUE = "stkzoo.agents.training.league.league"


@dataclass
class LeagueWords:
    """The words after ``stkzoo league``."""

    words: tuple[str, ...] = positional(())


def run(arguments: LeagueWords) -> int:
    """Runs the league's own command line."""
    return int(import_module(_LEAGUE).main(list(arguments.words)))
