"""The tutorials run in a short form, and the published pages match their sources."""

import json
import os
import re
import subprocess
import sys

import pytest

from tests.docs.test_extensions import extension
from tests.support.paths import ROOT
from tests.support.views import marked

pytestmark = pytest.mark.slow

tutorials = extension("tutorials")
PAGES, SOURCES, unexecuted = tutorials.PAGES, tutorials.SOURCES, tutorials.unexecuted

NAMES = sorted(path.stem for path in SOURCES.glob("*.py"))


@pytest.mark.parametrize(
    "name", marked([name for name in NAMES if name != "train_a_driver"], ["first_race"])
)
def test_a_tutorial_runs(name, tmp_path):
    assert pictures(executed(name, tmp_path, "--short")) >= 1


@pytest.mark.matrix
def test_the_first_training_gives_a_driver_that_beats_the_easiest_ai(tmp_path, monkeypatch):
    """Runs the whole tutorial with a third of its training steps."""
    monkeypatch.setenv("STKZOO_STEPS", "200000")
    notebook = executed("train_a_driver", tmp_path)
    assert pictures(notebook) >= 1
    rows = re.findall(r"^(\w+) +(\d) of 5 .* (\d\.\d)$", printed(notebook), re.MULTILINE)
    finished = {name: int(count) for name, count, _ in rows}
    place = {name: float(mean) for name, _, mean in rows}
    assert finished["Trained"] == 5
    assert place["Trained"] < min(place[name] for name in ("ai", "random", "Untrained"))


def executed(name, folder, *options):
    """Runs a tutorial and returns its notebook."""
    command = [sys.executable, tutorials.__file__, *options, "--only", name]
    done = subprocess.run(
        [*command, "--output", folder],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads((folder / f"{name}.ipynb").read_text("utf-8"))


def printed(notebook):
    outputs = [out for cell in notebook["cells"] for out in cell.get("outputs", [])]
    return "".join("".join(out.get("text", "")) for out in outputs)


def pictures(notebook):
    outputs = [out for cell in notebook["cells"] for out in cell.get("outputs", [])]
    return sum("image/png" in out.get("data", {}) for out in outputs)


@pytest.mark.parametrize("name", NAMES)
def test_the_page_matches_its_source(name):
    page = json.loads((PAGES / f"{name}.ipynb").read_text("utf-8"))
    assert [cell["source"] for cell in unexecuted(name).cells] == [
        "".join(cell["source"]) for cell in page["cells"]
    ]
    assert pictures(page) >= 1
    assert "error" not in {
        out["output_type"] for c in page["cells"] for out in c.get("outputs", [])
    }
    assert f"({name}.ipynb)" in (PAGES / "index.md").read_text()
