"""The tutorials run, in a short form; the pages show what their sources gave in full."""

import json
import os
import subprocess
import sys

import jupytext
import pytest

from benchmarks.tutorials import PAGES, ROOT, SOURCES

NAMES = sorted(path.stem for path in SOURCES.glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_tutorial_runs(name, tmp_path):
    command = [sys.executable, "-m", "benchmarks.tutorials", "--short", "--only", name]
    done = subprocess.run(
        [*command, "--output", tmp_path],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    assert pictures(json.loads((tmp_path / f"{name}.ipynb").read_text())) >= 1


def pictures(notebook):
    outputs = [out for cell in notebook["cells"] for out in cell.get("outputs", [])]
    return sum("image/png" in out.get("data", {}) for out in outputs)


@pytest.mark.parametrize("name", NAMES)
def test_the_page_is_of_this_source(name):
    source = jupytext.read(SOURCES / f"{name}.py", fmt="py:percent")
    page = json.loads((PAGES / f"{name}.ipynb").read_text("utf-8"))
    assert [cell["source"] for cell in source.cells] == [
        "".join(cell["source"]) for cell in page["cells"]
    ]
    assert pictures(page) >= 1
    assert "error" not in {
        out["output_type"] for c in page["cells"] for out in c.get("outputs", [])
    }
    assert f"{name}\n" in (PAGES / "index.md").read_text()
