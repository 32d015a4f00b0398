"""Builds the pages of the suite's reference results from ``benchmarks/results/suite*``.

``python docs/_extensions/suite_page.py`` draws their figures.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

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
_PILOT = """## Pilot

`python -m benchmarks.suite_pilot --kart-steps {kart_steps}` trained `ippo` in `{task}`, once with
the arguments of the reference runs and once with each change, all with seed {seed}. The agents and
four drivers raced against four of the game's hardest AI on the validation tracks, 16 races each.
*Argmax* is the most likely action instead of a sampled one.

| candidate | beaten | time ratio | unfinished | beaten, argmax | time ratio | unfinished |
| :-- | --: | --: | --: | --: | --: | --: |
"""
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
    sections = report_sections(report, figures)
    pilot = RESULTS / tier / "pilot.json"
    return f"{sections}\n\n{_pilot(json.loads(pilot.read_text()))}" if pilot.exists() else sections


def _pilot(results: Mapping[str, Any]) -> str:
    rows = results["candidates"].items()
    lines = (f"| {' | '.join([name, *_cells(kinds)])} |" for name, kinds in rows)
    return _PILOT.format_map(results) + "\n".join(lines)


def _cells(kinds: Mapping[str, Any]) -> Iterator[str]:
    """Returns the figures of sampled actions, or of a driver, then those of argmax."""
    for kind in (kinds.get("driver") or kinds["sampled"], kinds.get("argmax", {})):
        for name in ("beaten", "time_ratio", "unfinished"):
            yield f"{kind[name]:.3f}" if kind else ""


def _report(tier: str) -> SuiteReport | None:
    file = RESULTS / tier / "report.json"
    return SuiteReport.load(file) if file.exists() else None


if __name__ == "__main__":
    for name in _TIERS:
        if measured := _report(name):
            (PICTURES / name).mkdir(exist_ok=True)
            draw_figures(measured, PICTURES / name)
