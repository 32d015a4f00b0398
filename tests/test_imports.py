"""New interpreters find the program's modules, and none in the current folder."""

import os
import subprocess
import sys

import pytest

from stkzoo._imports import python_command, search_path


@pytest.fixture
def shadows(tmp_path):
    """Makes a folder with files that have the names of Python's modules."""
    for name in ("json", "linecache", "re", "runpy", "tokenize", "types"):
        (tmp_path / f"{name}.py").write_text(f"print({name!r})")
    return tmp_path


def test_a_new_interpreter_runs_no_file_in_the_current_folder(shadows):
    code = "import sys, json, linecache, re, runpy, tokenize, types; print(sys.argv[1:])"
    done = subprocess.run(
        python_command(code, "one", "two"), cwd=shadows, capture_output=True, text=True
    )
    assert done.stdout == "['one', 'two']\n", done.stderr


def test_the_search_path_names_the_current_folder_of_an_interactive_session(monkeypatch):
    monkeypatch.setattr(sys, "path", ["", "/elsewhere"])
    assert search_path() == [os.getcwd(), "/elsewhere"]


def test_the_search_path_can_leave_out_the_current_folder(monkeypatch):
    monkeypatch.setattr(sys, "path", ["", "/elsewhere"])
    assert search_path(has_current=False) == ["/elsewhere"]
