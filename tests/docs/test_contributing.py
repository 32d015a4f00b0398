"""CONTRIBUTING.md's recipes work in a copy of the project; docs/architecture.md names its files."""

import os
import re
import shlex
import shutil
import subprocess
import sys

import pytest

from tests.support.paths import ROOT, copy_checkout

pytestmark = pytest.mark.slow

PAGE = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
#: Each recipe, and text that its commands print.
RECIPES = {
    "Add a view": "",
    "Add a reward term": "",
    "Add a driver": "steady",
    "Add a command": "zengarden",
    "Add a game mode": "heuristic",
}


@pytest.mark.parametrize("title", RECIPES)
def test_a_recipe_works_as_it_is_written(title, tmp_path):
    copy = copy_checkout(tmp_path / "copy")
    for name in ("stkzoo/kernel", "stkzoo/engine", "agents/planning"):
        for built in (ROOT / name).glob("*.so"):
            shutil.copy(built, copy / name)
    recipe = re.search(rf"^## {title}\n(.*?)^## ", PAGE, re.MULTILINE | re.DOTALL)[1]
    commands = []
    for language, code in re.findall(r"```(\w+)\n(.*?)```", recipe, re.DOTALL):
        name = re.match(r"# (\S+\.py)\n", code)
        if language == "diff":
            apply_diff(copy, code)
        elif name:
            (copy / name[1]).parent.mkdir(exist_ok=True)
            (copy / name[1]).write_text(code)
        else:
            commands += [["-c", code]] if language == "python" else words_of(code)
    assert commands, "a recipe shows how to try its result"
    assert RECIPES[title] in "".join(run_in(copy, words) for words in commands)


def apply_diff(folder, diff):
    for name, lines in re.findall(r"^--- (\S+)\n((?:(?!---).*\n)+)", diff, re.MULTILINE):
        old, new = (
            "".join(f"{line[1:]}\n" for line in lines.splitlines() if line[0] in f" {sign}")
            for sign in "-+"
        )
        text = (folder / name).read_text("utf-8")
        assert text.count(old) == 1, f"{name}: {old}"
        (folder / name).write_text(text.replace(old, new))


def words_of(shell):
    for line in shell.splitlines():
        program, *words = shlex.split(line)
        yield ["-m", program, *words] if program == "stkzoo" else words


def run_in(folder, words):
    """Runs Python in a copy of the project; returns what it prints."""
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), "CFLAGS": "-O0"},  # builds faster
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_architecture_page_names_files_that_exist():
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    folders = [ROOT, ROOT / "stkzoo", ROOT / "agents"]
    named = set(re.findall(r"`([a-z_/0-9]+\.py|[a-z_]+/[a-z_/]*)`", page))
    assert len(named) > 40
    missing = [n for n in named if not any((folder / n).exists() for folder in folders)]
    assert missing == []
