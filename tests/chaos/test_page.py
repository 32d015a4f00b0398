"""The page of robustness says what the results say."""

import re

from benchmarks import chaos_table
from tests.support.paths import ROOT


def test_the_table_is_that_of_the_results():
    page = chaos_table.PAGE.read_text(encoding="utf-8")
    assert page == chaos_table.updated(page), "python -m benchmarks.chaos_table --write"


def test_every_test_that_the_page_names_exists():
    page = chaos_table.PAGE.read_text(encoding="utf-8")
    code = "".join(file.read_text() for file in (ROOT / "tests" / "chaos").glob("test_*.py"))
    named = set(re.findall(r"`(test_\w+)`", page))
    assert len(named) > 9
    assert {name for name in named if f"def {name}(" not in code} == set()
    for file in re.findall(r"`(tests/chaos/\w+\.py)`", page):
        assert (ROOT / file).is_file()
