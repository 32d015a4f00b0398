"""Pages and charts of saved results are built from all of them."""

import json
import re

import pytest

from tests.docs.test_extensions import extension
from tests.support.paths import ROOT


def test_the_page_of_results_shows_the_tables_of_each_benchmark():
    (text,) = extension("result_page").pages().values()
    for file in ("steps", "learners", "remote"):
        report = json.loads((ROOT / "benchmarks" / "results" / f"{file}.json").read_text())
        assert report["command"] in text
        assert all(" | ".join(row) in text for row in report["tables"][0]["rows"])


def test_the_page_of_the_suite_has_its_tables_and_figures():
    (text,) = extension("suite_page").pages().values()
    assert re.search(r"^\| versus \| ippo \| beaten \| 3 \|", text, re.MULTILINE)
    assert text.count("](../images/suite/") == 4


@pytest.mark.slow
def test_the_charts_show_the_saved_results(tmp_path):
    charts = extension("charts")
    charts.main(tmp_path)
    for name in charts.CHARTS:
        labels = re.findall("<!-- (.*?) -->", (tmp_path / f"{name}.svg").read_text())
        shown = re.findall("<!-- (.*?) -->", (charts.PICTURES / f"{name}.svg").read_text())
        assert labels == shown != []
