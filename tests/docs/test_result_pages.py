"""Pages and charts of saved results are built from all of them."""

import json
import re

import pytest

from stkzoo.suite import make_report
from tests.docs.test_extensions import extension
from tests.support.paths import ROOT
from tests.support.suite_runs import constant, suite_run

PAGE = "explanation/suite-results.md"


def test_the_page_of_results_shows_the_tables_of_each_benchmark():
    (text,) = extension("result_page").pages().values()
    for file in ("steps", "learners", "remote"):
        report = json.loads((ROOT / "benchmarks" / "results" / f"{file}.json").read_text())
        assert report["command"] in text
        assert all(" | ".join(row) in text for row in report["tables"][0]["rows"])


def test_the_page_of_the_suite_has_its_tables_and_figures(tmp_path, monkeypatch):
    page = extension("suite_page")
    results = page.pages()[PAGE]
    assert "# Results of the suite's reference algorithms" in results
    assert "| ai | 0.469 | 1.002 | 0.000 |  |  |  |" in results
    assert re.search(r"\| gamma 0.98 (\| \d\.\d{3} ){6}\|", results)
    report = make_report([suite_run("versus", "ippo", 0, constant(0.5))])
    for name in ("RESULTS", "PICTURES"):
        monkeypatch.setattr(page, name, tmp_path)
    assert "have not been measured yet" in page.pages()[PAGE]
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite/report.json").write_text(report.to_json())
    page.draw_figures(report, tmp_path / "suite")
    text = page.pages()[PAGE]
    assert "## versus" in text
    assert text.count("](../images/suite/") == 1  # scores; there are no logs and no comparisons


@pytest.mark.slow
def test_the_charts_show_the_saved_results(tmp_path):
    charts = extension("charts")
    charts.main(tmp_path)
    for name in charts.CHARTS:
        labels = re.findall("<!-- (.*?) -->", (tmp_path / f"{name}.svg").read_text())
        shown = re.findall("<!-- (.*?) -->", (charts.PICTURES / f"{name}.svg").read_text())
        assert labels == shown != []
