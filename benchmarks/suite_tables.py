"""Writes tables and figures of ``docs/explanation/suite-report.md`` from the saved results.

    python -m benchmarks.suite_tables
    python -m benchmarks.suite_tables --results trial --page trial/page.md --pictures trial

The text of the page is written by hand; this command replaces the parts between its marks. It
lists runs without a result.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from benchmarks import suite_intervals
from benchmarks.suite_reference import OUTPUT, reference_keys
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.suite import load_runs, make_report
from stkzoo.suite.report.figures import draw_figures
from stkzoo.suite.report.tables import missing_runs, report_sections

_DOCS = Path(__file__).parents[1] / "docs"
PAGE = _DOCS / "explanation" / "suite-report.md"
PICTURES = _DOCS / "images" / "suite"


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.suite_tables", description=__doc__)
    words.add_argument("--results", type=Path, default=OUTPUT, help="folder of the results")
    words.add_argument("--page", type=Path, default=PAGE, help="page to write")
    words.add_argument("--pictures", type=Path, default=PICTURES, help="folder of the figures")
    options = words.parse_args(arguments)
    page = PAGE.read_text("utf-8")
    page = replaced(page, "intervals", _interval_table())
    page = replaced(page, "results", results(options.results, options.pictures, options.page))
    write_text(options.page, page)
    print(f"written to {options.page}")
    return 0


def replaced(page: str, name: str, text: str) -> str:
    """Returns a page with the text between two marks replaced.

    Args:
        page: the page.
        name: name of the marks.
        text: the text.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, _, rest = page.partition(begin)
    return f"{before}{begin}\n\n{text}\n\n{end}{rest.partition(end)[2]}"


def results(folder: Path, pictures: Path, page: Path) -> str:
    """Returns the tables and figures of the results in a folder, and draws the figures.

    Args:
        folder: folder of the results.
        pictures: folder for the figures.
        page: the page that shows them.
    """
    keys = list(reference_keys())
    if not any(folder.glob("*.json")):
        return f"## Results\n\nNo run has a result yet. Missing are:\n\n{missing_runs(keys)}"
    report = make_report(load_runs([folder]), keys)
    pictures.mkdir(parents=True, exist_ok=True)
    figures = {
        name: Path(os.path.relpath(pictures / file, page.parent))
        for name, file in draw_figures(report, pictures).items()
    }
    return report_sections(report, figures)


def _interval_table() -> str:
    found = json.loads(suite_intervals.OUTPUT.read_text("utf-8"))
    names = [
        *("runs, same", "runs and tracks, same", "each score, other", "runs, other"),
        *("runs and columns, other", "runs and tracks, other", "IQM, other"),
    ]
    head = "| runs | track | run | both | alike | "
    head += " | ".join(f"{name} tracks" for name in names) + " |"
    rule = "| ---: " * (5 + len(names)) + "|"
    rows = [
        f"| {row['runs']} | {row['by_track']:.2f} | {row['by_run']:.2f} | {row['by_both']:.2f} | "
        f"{row['alike']:.1f} | " + " | ".join(f"{100 * row[name]:.0f}%" for name in names) + " |"
        for row in found["rows"]
    ]
    return "\n".join([head, rule, *rows])


if __name__ == "__main__":
    sys.exit(main())
