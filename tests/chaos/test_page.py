"""The robustness page matches the saved results."""

import re

from benchmarks import chaos_table
from tests.support.paths import ROOT


def test_the_table_matches_the_results():
    page = chaos_table.PAGE.read_text(encoding="utf-8")
    assert page == chaos_table.updated(page), "python -m benchmarks.chaos_table --write"


def test_every_test_file_that_the_page_names_exists():
    page = chaos_table.PAGE.read_text(encoding="utf-8")
    files = re.findall(r"`(tests/chaos/\w+\.py)`", page)
    assert len(files) > 4
    assert [file for file in files if not (ROOT / file).is_file()] == []
