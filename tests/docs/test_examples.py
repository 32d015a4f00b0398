"""Every example in the documentation is valid: Python runs, and commands run or are parsed."""

import importlib
import importlib.util
import re
import shutil
import zipfile
from pathlib import Path
from unittest import mock

import pytest

from stkzoo.agents.training.common.command import command_parser
from stkzoo.cli import build_parser, main
from tests.docs.test_extensions import extension
from tests.support.docs_blocks import (
    NOT_RUN,
    ROOT,
    SHORTER,
    blocks,
    commands,
    pages,
    reason_not_to_run,
    shortened,
)
from tests.support.programs import ProgramRunner

PAGES = pages()
#: What the pages share. Each block runs in a new namespace, like a reader who copies only this
#: block. A block can read files that an earlier one wrote.
IMPORTS = """
import doctest, gymnasium, json, matplotlib.pyplot, pettingzoo, stable_baselines3, torch
import stkzoo.race, stkzoo.sb3

def run_blocks(blocks):
    for page, line, code in blocks:
        names = {"__name__": "__main__"}
        if ">>>" in code:
            example = doctest.DocTestParser().get_doctest(code, names, page, page, line)
            doctest.DebugRunner().run(example)
        else:
            exec(compile("\\n" * line + code, page, "exec"), names)
"""

#: Commands that run as written, with options that shorten them.
SHORT = {
    "race": ["--max-steps", "10"],
    "replay": [],
    "tracks": ["lighthouse"],
    "karts": [],
    "keys": [],
}
#: The same for films; tests/race/test_video.py and test_replay.py have the game render them.
IN_FILMS = ["--render-backend", "map"]
#: Commands that are only parsed here, and the tests that run them.
PARSED = {
    "assets": "it is here already: tests/engine/test_assets.py",
    "benchmark": "hundreds of races: tests/evaluation/test_benchmark_races.py",
    "check": "tests/cli/test_new_and_check.py",
    "completion": "tests/cli/test_tables.py",
    "demos": "whole races: tests/evaluation/test_demonstrations.py",
    "doctor": "tests/cli/test_doctor.py",
    "report": "tests/evaluation/test_tournament_report.py",
    "new": "tests/cli/test_new_and_check.py",
    "play": "opens a window: tests/play/test_play.py",
    "race-client": "needs a server: tests/cli/test_remote.py",
    "race-server": "serves until it is stopped: tests/cli/test_remote.py",
    "tracks": "starts a race on each track: tests/cli/test_tables.py",
    "tournament": "many races: tests/evaluation/test_tournament.py",
    "--web": "in real time, for viewers: tests/race/web/test_browser.py",
    "--demo": "in a terminal: tests/cli/test_race.py",
    "-h": "",
}


OTHER_PROGRAMS = [
    *("pip", "apt", "sudo", "python3", ".", "cd", "git", "ray", "tensorboard", "conda"),
    *("docker", "export", "jupyter", "uv"),
]


def enter_folder(path, monkeypatch):
    """Creates a folder with the agents that the pages mention, and changes to it."""
    agent, *_ = (b for b in blocks("docs/reference/agents.md", "python") if b.file)
    for name in ("my_agent", "my_driver", "my_team", "agents/one", "agents/swift"):
        (path / name).mkdir(parents=True)
        (path / name / "pystk_actor.py").write_text(agent.code)
    with zipfile.ZipFile(path / "rival.zip", "w") as packed:
        packed.writestr("pystk_actor.py", agent.code)
    monkeypatch.chdir(path)


@pytest.fixture(scope="module")
def runner():
    with ProgramRunner(IMPORTS) as runner:
        yield runner


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_each_python_block_of_a_page_runs_on_its_own(page, runner, tmp_path, monkeypatch):
    enter_folder(tmp_path, monkeypatch)
    shutil.rmtree(tmp_path / "my_driver")  # pages make it
    to_run = []
    for block in blocks(page, "python"):
        if reason_not_to_run(block):
            continue
        if block.file:
            path = tmp_path / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.code)
        else:
            to_run.append((page, block.line, shortened(block)))
    done = runner.run(f"run_blocks({to_run!r})", tmp_path)
    assert done.returncode == 0, done.stdout[-1000:] + done.stderr[-4000:]


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "sh")])
def test_each_shell_block_of_a_page_is_valid(page, tmp_path, monkeypatch):
    for number, block in enumerate(blocks(page, "sh")):
        enter_folder(tmp_path / str(number), monkeypatch)
        for words in commands(block):
            try_command(words)


def try_command(words):
    program, *rest = words
    if program == "stkzoo":
        try_stkzoo(rest)
    elif program in OTHER_PROGRAMS:
        extras = re.search(r"(?:stkzoo|\.)\[([\w,-]+)\]", " ".join(rest))
        for extra in extras[1].split(",") if extras else ():
            assert re.search(rf"^{extra} = \[", (ROOT / "pyproject.toml").read_text(), re.M), words
    elif program == "make":
        assert re.search(rf"^{rest[0]}:", (ROOT / "Makefile").read_text(), re.M), words
    elif program == "python" and rest[0] == "-m":
        assert importlib.util.find_spec(rest[1].split("|")[0]), words
        if rest[1].startswith("stkzoo.agents.training."):
            parse_training(rest[1], rest[2:])
    elif program == "python":
        assert (ROOT / rest[0]).exists(), words
    else:
        pytest.fail(f"who tries {' '.join(words)}? Say so in tests/docs/test_examples.py")


def parse_training(name, words):
    module = importlib.import_module(name)

    def parse(command, description, _, kinds, given, *__):
        command_parser(command, description, kinds).parse_args(given)
        return 0

    with mock.patch.object(module, "run_command", parse):
        assert module.main(words) == 0


def try_stkzoo(words):
    if "|" in words or "$(awk" in words:
        return  # a list of commands, or a command that contains another one's output
    words = words[: words.index(">")] if ">" in words else words
    assert is_understood(words), f"stkzoo {' '.join(words)}"
    if words[0] in SHORT and not PARSED.keys() & set(words):
        options = [*SHORT[words[0]], *(IN_FILMS if "--video" in words else ())]
        assert main([*words, *options]) == 0, f"stkzoo {' '.join(words)}"


def is_understood(words):
    try:
        build_parser().parse_args(words)
    except SystemExit as end:
        return end.code == 0
    return True


@pytest.mark.parametrize(("page", "part", "reason"), NOT_RUN)
def test_blocks_that_do_not_run_exist_and_are_tested_elsewhere(page, part, reason):
    assert any(part in block.code for block in blocks(page, "python"))
    (place,) = re.findall(r"[\w/]+\.py", reason)
    assert (ROOT / place).exists()


@pytest.mark.parametrize(("page", "old"), [(page, old) for page, old, _ in SHORTER])
def test_shortened_code_exists(page, old):
    assert any(old in block.code for block in blocks(page, "python"))


def test_tests_that_run_the_other_commands_exist():
    for reason in PARSED.values():
        for place in re.findall(r"tests/[\w/]+\.py", reason):
            assert (ROOT / place).exists(), place


def test_every_image_of_the_pages_exists():
    texts = {page: (ROOT / page).read_text("utf-8") for page in PAGES}
    gallery = extension("gallery_page").pages()  # a checkout has it after the site is built
    for page, text in [*texts.items(), *((f"docs/{name}", text) for name, text in gallery.items())]:
        for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+)\)", text):
            assert (ROOT / Path(page).parent / target).exists(), f"{page}: {target}"
