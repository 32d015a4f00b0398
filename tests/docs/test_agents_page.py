"""The examples of docs/reference/agents.md work."""

import re

import pytest

from stkzoo.race import ERROR_HANDLING, RaceSettings, run_race
from tests.support.paths import ROOT

pytestmark = pytest.mark.slow

PAGE = (ROOT / "docs" / "reference" / "agents.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


def write(name, folder):
    """Writes an agent from the page into a folder and returns its path."""
    mark = f"# {name}/pystk_actor.py\n"
    (code,) = [block for block in BLOCKS if block.startswith(mark)]
    (folder / name).mkdir()
    (folder / name / "pystk_actor.py").write_text(code)
    return str(folder / name)


def test_the_agent_of_the_page_finishes(tmp_path):
    result = run_race([write("my_agent", tmp_path), "ai"], track="lighthouse", seed=1)
    assert result.is_finished
    assert "Beginner" in {row.driver for row in result.agents}


def test_the_pages_python_example_runs(tmp_path, monkeypatch, capsys):
    write("my_agent", tmp_path)
    monkeypatch.chdir(tmp_path)
    (code,) = [block for block in BLOCKS if "class Leader" in block]
    exec(compile(code, "docs/reference/agents.md", "exec"), {})
    shown = capsys.readouterr().out
    assert "Beginner" in shown
    assert "10.0 s" in shown


def test_the_page_lists_the_defaults():
    settings = RaceSettings()
    for name, unit in (("action_timeout", " s"), ("start_timeout", " s"), ("agent_memory", " MB")):
        flag = name.replace("_", "-")
        assert f"--{flag}` ({getattr(settings, name):g}{unit})" in PAGE
    assert f"--max-restarts` ({settings.max_restarts})" in PAGE
    for handling in ERROR_HANDLING:
        assert f"| `{handling}`" in PAGE
    assert f"`{settings.error_handling}` (default)" in PAGE
