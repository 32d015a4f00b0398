"""Builds the page of the suite's reference results from ``benchmarks/results/suite/report.json``.

``python docs/_extensions/suite_page.py`` draws its figures.
"""

from __future__ import annotations

from pathlib import Path

from stkzoo.suite import SuiteReport
from stkzoo.suite.report.figures import FIGURES, draw_figures
from stkzoo.suite.report.writing import report_sections

REPORT = Path(__file__).parents[2] / "benchmarks" / "results" / "suite" / "report.json"
PICTURES = Path(__file__).parents[1] / "images" / "suite"
_HEAD = """\
# Results of the suite's reference algorithms

[The report](suite-report.md) describes the tasks, the statistics and the limits.
"""
_NOTHING = "The reference runs of this version of the suite have not been measured yet."


def pages() -> dict[str, str]:
    """Returns the text of the page."""
    files = {name: Path("../images/suite", f"{name}.svg") for name in FIGURES}
    figures = {name: file for name, file in files.items() if (PICTURES / file.name).exists()}
    text = report_sections(SuiteReport.load(REPORT), figures) if REPORT.exists() else _NOTHING
    return {"explanation/suite-results.md": f"{_HEAD}\n{text}\n"}


if __name__ == "__main__":
    draw_figures(SuiteReport.load(REPORT), PICTURES)
