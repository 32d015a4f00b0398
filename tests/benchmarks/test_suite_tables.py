"""The report page is built from any set of results and lists the missing runs."""

import json

import pytest

from benchmarks import suite_intervals, suite_tables
from tests.support.suite_runs import suite_run, write_run


def build(tmp_path, runs):
    (tmp_path / "results").mkdir()
    for run in runs:
        write_run(tmp_path / "results", run)
    words = ["--results", str(tmp_path / "results"), "--page", str(tmp_path / "page.md")]
    assert suite_tables.main([*words, "--pictures", str(tmp_path / "pictures")]) == 0
    return (tmp_path / "page.md").read_text("utf-8")


def test_the_page_without_results_lists_all_runs(tmp_path):
    page = build(tmp_path, [])
    assert "No run has a result yet" in page
    assert "- versus, ippo: seed 0, 1, 2\n" in page
    assert "versus, fsp" not in page  # fsp does not run on tasks with one learner
    assert not (tmp_path / "pictures").exists()


@pytest.mark.slow
def test_the_page_with_some_results_has_their_tables_and_figures(tmp_path):
    page = build(tmp_path, [suite_run("versus", "ippo", 0)])
    assert "| versus | ippo | beaten | 1 |" in page
    assert "- versus, ippo: seed 1, 2\n" in page
    assert "(pictures/scores.svg)" in page
    assert (tmp_path / "pictures" / "scores.svg").exists()


def test_only_the_section_between_the_marks_is_replaced():
    page = "one\n<!-- a: begin -->\nold\n<!-- a: end -->\ntwo\n"
    found = suite_tables.replaced(page, "a", "new")
    assert found == "one\n<!-- a: begin -->\n\nnew\n\n<!-- a: end -->\ntwo\n"
    assert suite_tables.replaced(found, "a", "new") == found


def test_the_page_in_the_docs_is_up_to_date(tmp_path):
    shown = suite_tables.PAGE.read_text("utf-8")
    pictures = tmp_path / "images" / "suite"
    page = tmp_path / "explanation" / "suite-report.md"
    page.parent.mkdir()
    words = ["--page", str(page), "--pictures", str(pictures)]
    assert suite_tables.main(words) == 0
    assert page.read_text("utf-8") == shown, "run: python -m benchmarks.suite_tables"


@pytest.mark.slow
def test_intervals_over_runs_and_tracks_have_better_coverage_than_over_single_scores(tmp_path):
    output = tmp_path / "intervals.json"
    assert suite_intervals.main(["--trials", "20", "--output", str(output)]) == 0
    for row in json.loads(output.read_text())["rows"]:
        assert row["each score, other"] < row["runs and tracks, other"]
        assert row["each score, same"] < row["runs and tracks, same"]
