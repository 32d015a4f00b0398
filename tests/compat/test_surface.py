"""The surface of pystk2-gymnasium is there under ``stkzoo.compat``, or listed as left out."""

import json
import os
import re
import subprocess
import sys

import pytest

from stkzoo.engine.assets import find_assets
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow

PRINT = "import json; from tests.support import surface; print(json.dumps(list(surface.{})))"


def run_python(code, **options):
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        **options,
    )
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def missing():
    """Returns the missing name and the error's text by path."""
    environment = {**os.environ, "SUPERTUXKART_DATADIR": str(find_assets().root)}
    code = PRINT.format("names()) + list(surface.attributes()")
    paths = run_python(code, cwd=ROOT, env=environment)
    assert len(paths) > 400
    code = f"import stkzoo.compat\n{PRINT}".format(f"missing({paths!r})")
    return {path: (name, text) for path, name, text in run_python(code, cwd=ROOT)}


def test_errors_for_names_that_are_left_out_say_what_to_use_instead(missing):
    without_hint = [
        (path, text)
        for path, (_, text) in missing.items()
        if not re.search(
            r"^use |unlike in pystk2-gymnasium; |^stkzoo has no module .*: |lists", text
        )
    ]
    assert without_hint == []


def test_the_page_of_differences_lists_exactly_the_names_that_are_left_out(missing):
    page = (ROOT / "docs/reference/differences.md").read_text("utf-8")
    rows = page.partition("## Names that are left out")[2].partition("\n## ")[0]
    listed = set(re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (.*?) \|", rows, re.MULTILINE))))
    assert listed == {name for name, _ in missing.values()}
