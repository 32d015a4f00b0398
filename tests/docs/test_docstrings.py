"""The examples in docstrings run."""

import doctest
import importlib

import pytest

from tests.support.paths import ROOT


def modules():
    """Yields the names of the modules with examples."""
    for folder, package in (("stkzoo", ""), ("wrappers", "stkzoo."), ("agents", "stkzoo.")):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if ">>> " in path.read_text("utf-8"):
                parts = path.relative_to(ROOT).with_suffix("").parts
                yield package + ".".join(part for part in parts if part != "__init__")


@pytest.mark.slow
@pytest.mark.parametrize("name", list(modules()))
def test_the_examples_of_a_module_run(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > outcome.failed == 0
