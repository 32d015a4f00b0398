"""Runs the tutorials and writes them as notebooks with their outputs.

    python docs/_extensions/tutorials.py                       # all, in full: about 30 minutes
    python docs/_extensions/tutorials.py --only first_race     # one of them
    python docs/_extensions/tutorials.py --short --output DIR  # only check that they run: a minute

The tutorials are Python files, ``examples/tutorials/*.py``. Each notebook gets a badge that opens
it in Colab and a cell that installs stkzoo there.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from stkzoo._arguments import CommandParser
from stkzoo._installation import project_url
from stkzoo._os import write_text

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "examples" / "tutorials"
PAGES = ROOT / "docs" / "tutorials"
#: Extras of stkzoo that each tutorial needs.
EXTRAS = {
    "first_race": "races",
    "plan_with_saved_states": "races",
    "self_play_and_ratings": "sb3,races",
    "train_a_driver": "sb3,races",
}
_BADGE = """\
[![Open in Colab](../_static/colab.svg)](https://colab.research.google.com/github/{path}/blob/main/docs/tutorials/{name}.ipynb)
"""
_SETUP = """\
# Installs stkzoo where it is missing, such as in Colab. Elsewhere this cell does nothing.
import importlib.util
import pathlib
import subprocess
import sys


def install_stkzoo():
    \"""Installs the wheel and the game data beside this notebook, or downloads them.\"""
    wheel = next(pathlib.Path.cwd().glob("stkzoo-*.whl"), None)
    pack = next(pathlib.Path.cwd().glob("*.tar.xz"), None)
    source = wheel.as_uri() if wheel else "git+{url}"
    python = [sys.executable, "-m"]
    requirement = f"stkzoo[{extras}] @ {{source}}"
    if subprocess.run([*python, "pip", "install", "-q", requirement]).returncode:
        raise SystemExit(
            f"pip cannot install stkzoo from {{source}}. Build a wheel with `make release`, "
            "upload it beside this notebook, and run this cell again."
        )
    options = ["--from", str(pack)] if pack else []
    subprocess.run([*python, "stkzoo", "assets", "install", *options], check=True)


if importlib.util.find_spec("stkzoo") is None:
    install_stkzoo()
"""


def main() -> int:
    """Runs the command; returns its exit code."""
    parser = CommandParser(prog="python docs/_extensions/tutorials.py", description=__doc__)
    parser.add_argument("--only", nargs="+", metavar="NAME", help="only these")
    parser.add_argument("--short", action="store_true", help="run only a few steps")
    parser.add_argument("--output", type=Path, help="folder (default: docs/tutorials)")
    arguments = parser.parse_args()
    if arguments.short and arguments.output is None:
        parser.error("--short needs --output: the pages show the full runs")
    names = arguments.only or sorted(path.stem for path in SOURCES.glob("*.py"))
    for name in names:
        if not (SOURCES / f"{name}.py").exists():
            parser.error(f"there is no tutorial {name!r} in {SOURCES}")
    folder = arguments.output or PAGES
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        begun = time.monotonic()
        write_text(folder / f"{name}.ipynb", executed(name, short=arguments.short))
        print(f"{name}: {time.monotonic() - begun:.0f} s", flush=True)
    return 0


def executed(name: str, *, short: bool) -> str:
    """Runs a tutorial in a temporary folder; returns the text of the notebook."""
    import nbformat
    from nbclient import NotebookClient

    notebook = unexecuted(name)
    switches = {"STKZOO_SHORT": "1"} if short else {}
    os.environ.update(switches)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=3600, resources=resources).execute()
    return nbformat.writes(_without_traces(notebook)) + "\n"


def unexecuted(name: str) -> Any:
    """Returns a tutorial as a notebook without outputs, with a cell that installs stkzoo."""
    import jupytext
    from nbformat.v4 import new_code_cell, new_markdown_cell

    notebook = jupytext.read(SOURCES / f"{name}.py", fmt="py:percent")
    url = project_url("Repository")
    badge = _BADGE.format(path=urlsplit(url).path.strip("/"), name=name)
    setup = new_code_cell(_SETUP.format(url=url, extras=EXTRAS[name]).rstrip())
    setup.metadata["tags"] = ["hide-input"]
    notebook.cells[1:1] = [new_markdown_cell(badge.rstrip()), setup]
    return notebook


def _without_traces(notebook: Any) -> Any:
    """Removes everything that differs between runs or describes this machine."""
    notebook.metadata.pop("language_info", None)
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [out for out in cell.outputs if out.get("name") != "stderr"]
    return notebook


if __name__ == "__main__":
    sys.exit(main())
