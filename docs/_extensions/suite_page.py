"""Builds the page of the suite's reference results from ``benchmarks/results/suite``.

``python docs/_extensions/suite_page.py`` draws its figures.
"""

from __future__ import annotations

from pathlib import Path

from stkzoo.suite import load_runs, make_report
from stkzoo.suite.report.figures import draw_figures
from stkzoo.suite.report.writing import CAPTIONS, report_sections

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "suite"
PICTURES = Path(__file__).parents[1] / "images" / "suite"
_HEAD = """\
# Results of the suite's reference algorithms

[The report](suite-report.md) describes the tasks, the statistics and the limits.
"""


def pages() -> dict[str, str]:
    """Returns the text of the page."""
    files = {name: Path("../images/suite", f"{name}.svg") for name in CAPTIONS}
    figures = {name: file for name, file in files.items() if (PICTURES / file.name).exists()}
    text = report_sections(make_report(load_runs([RESULTS])), figures)
    return {"explanation/suite-results.md": f"{_HEAD}\n{text}\n"}


if __name__ == "__main__":
    draw_figures(make_report(load_runs([RESULTS])), PICTURES)
