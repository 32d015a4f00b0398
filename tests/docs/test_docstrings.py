"""The examples in docstrings run."""

import doctest
import importlib
import sys
from unittest.mock import patch

import pytest

from stkzoo.views.agent_chain import AgentChain
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
    monkeypatch.setattr(AgentChain, "is_strict", True)  # stkzoo.compat changes it, and modules
    with patch.dict(sys.modules):
        outcome = doctest.testmod(importlib.import_module(name))
    assert outcome.attempted > outcome.failed == 0
