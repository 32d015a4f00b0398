"""Write the report of a tournament: one page, and tables as CSV.

Writes report.html, standings.csv and races.csv to the tournament's folder. Each tournament does
this when it ends; this command also works while a tournament is running. With --publish, writes
index.html and the tables to another folder, without error messages, tracebacks, addresses, paths
and replays.

The page is one file. It needs no server, loads no other files and runs no scripts.

Examples:
  stkzoo report league
  stkzoo report league --publish public --title "Racing course 2026"
  stkzoo report league --films 0 17 42             animate these races
"""

from __future__ import annotations

from dataclasses import dataclass

from stkzoo._arguments import option, positional
from stkzoo.cli._console import say
from stkzoo.evaluation import write_report


@dataclass
class ReportArguments:
    """Options of ``stkzoo report``.

    Attributes:
        folder: folder of the tournament
        publish: write a page without private details to FOLDER
        title: heading of the page
        films: races to animate on the map (default: six races of the best agents)
    """

    folder: str = positional(metavar="FOLDER")
    publish: str | None = option(metavar="FOLDER")
    title: str = "Tournament"
    films: tuple[int, ...] = option((), metavar="RACE")


def run(arguments: ReportArguments) -> int:
    """Writes the report."""
    page = write_report(
        arguments.folder,
        publish=arguments.publish,
        title=arguments.title,
        films=arguments.films or None,
    )
    say(f"Wrote {page}, and beside it standings.csv and races.csv")
    return 0
