"""Write the report of a tournament: one page, and tables as CSV.

Writes report.html, standings.csv and races.csv to the tournament's folder. Each tournament does
this when it ends; this command also works while a tournament is running. With --publish, writes
index.html and the tables to another folder, without error messages, tracebacks, addresses, paths
and replays.

The page is one file. It needs no server, loads no other files and runs no scripts.

Examples:
  stkzoo report league
  stkzoo report league --publish public --title "Racing course 2026"
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
    """

    folder: str = positional(metavar="FOLDER")
    publish: str | None = option(metavar="FOLDER")
    title: str = "Tournament"


def run(arguments: ReportArguments) -> None:
    """Writes the report."""
    page = write_report(**vars(arguments))
    say(f"Wrote {page}, and beside it standings.csv and races.csv")
