"""Builds the pages of the suite's reference results from ``benchmarks/results/suite*/report.json``.

``python docs/_extensions/suite_page.py`` draws their figures.
"""

from __future__ import annotations

from pathlib import Path

from stkzoo.suite import SuiteReport
from stkzoo.suite.report.figures import FIGURES, draw_figures
from stkzoo.suite.report.writing import report_sections

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
PICTURES = Path(__file__).parents[1] / "images"
#: Folders of the results of each budget, with the titles of their pages.
_TIERS = {
    "suite": "Results of the suite's reference algorithms",
    "suite-long": "Results of the suite's long tier",
}
_HEAD = "[The report](suite-report.md) describes the tasks, the statistics and the limits."
_NOTHING = "The reference runs of this version of the suite have not been measured yet."


def pages() -> dict[str, str]:
    """Returns the text of the pages."""
    return {
        f"explanation/{tier}-results.md": f"# {title}\n\n{_HEAD}\n\n{_text(tier)}\n"
        for tier, title in _TIERS.items()
    }


def _text(tier: str) -> str:
    report = _report(tier)
    if report is None:
        return _NOTHING
    files = {name: Path("../images", tier, f"{name}.svg") for name in FIGURES}
    figures = {name: file for name, file in files.items() if (PICTURES / tier / file.name).exists()}
    return report_sections(report, figures)


def _report(tier: str) -> SuiteReport | None:
    file = RESULTS / tier / "report.json"
    return SuiteReport.load(file) if file.exists() else None


if __name__ == "__main__":
    for name in _TIERS:
        if measured := _report(name):
            (PICTURES / name).mkdir(exist_ok=True)
            draw_figures(measured, PICTURES / name)
