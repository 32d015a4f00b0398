"""Each module of the command line is a command."""

import argparse
import re
import shlex
import signal
from pathlib import Path

import pytest

import stkzoo.cli
from stkzoo.agents.training.common.command import run_command as run_training
from stkzoo.cli import COMMANDS, build_parser, main
from stkzoo.cli.tracks import TracksArguments

MODULES = sorted(Path(stkzoo.cli.__file__).parent.glob("[!_]*.py"))


def test_each_public_module_is_a_command():
    assert sorted(COMMANDS) == sorted(module.stem.replace("_", "-") for module in MODULES)


def test_the_help_lists_each_command_with_its_summary(capsys):
    assert main(["--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for text in ("keys make keys for networked races", "The documentation is at https://"):
        assert text in shown


def parsers(parser, name="stkzoo"):
    yield name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, child in action.choices.items():
                yield from parsers(child, f"{name} {word}")


def test_the_help_of_each_command_fits_80_columns_and_says_what_a_difficulty_is(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for name, parser in parsers(build_parser()):
        shown = parser.format_help()
        assert max(map(len, shown.splitlines())) <= 80, name
        if "--difficulty" in parser._option_string_actions:
            assert "speed of all karts, 0 to 3" in " ".join(shown.split()), name
        assert len(parser.format_usage().splitlines()) <= 3, name


def test_every_command_has_examples_that_can_be_parsed():
    for name, parser in parsers(build_parser()):
        text = parser.format_help()
        assert name.count(" ") != 1 or text.count(name) >= 2, name
        for line in (parser.epilog or "").splitlines():
            if line.startswith("  stkzoo ") and "COMMAND" not in line:
                words = shlex.split(line.strip().split("  ")[0].split(" > ")[0].split(" # ")[0])
                build_parser().parse_args(words[1:])


@pytest.mark.parametrize("command", COMMANDS)
def test_only_the_arguments_of_the_given_command_are_declared(command):
    (subparsers,) = (action for action in build_parser(command)._actions if action.choices)
    declared = [name for name, child in subparsers.choices.items() if child.description]
    assert declared == [command]


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["tournement"], "tournament"),
        (["assets", "instal"], "install"),
        (["race", "heuristic", "--trak", "lighthouse"], "--track"),
        (["race", "heuristic", "--outptu=a.json"], "--output"),
        (["assets", "pack", "--outptu", "x"], "--output"),
        (["race", "ai", "--karts", "1"], "--karts-finished"),
        (["race", "ai", "--err", "catch"], "--error-handling"),
        (["race", "ai", "--error-handling", "ctch"], "catch"),
    ],
)
def test_an_unknown_word_is_reported_with_the_nearest_valid_one(words, meant, capsys):
    assert main(words) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert meant in said
    assert "--help`" in said


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", [["tracks", "olivermath"], ["karts", "--json"], ["race", "--help"]]
)
def test_a_closed_pipe_causes_no_traceback(words, run_command):
    reader_ends = "reader, writer = os.pipe(); os.close(reader); os.dup2(writer, 1)"
    done = run_command(words, before=reader_ends)
    assert done.stderr == ""
    assert done.returncode in (0, 1)  # argparse ignores the broken pipe


TOLD_TO_END = """
    import time

    number = signal.{name}
    signal.signal(number, signal.SIG_DFL)  # the tests may run with nohup

    def command(words):
        try:
            os.kill(os.getpid(), number)
            time.sleep(60)
        finally:
            os.kill(os.getpid(), number)  # as `timeout` does
            print("kept", flush=True)
        return 0

    cli._exit_code = command
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_command_that_is_told_to_end_stops_like_after_ctrl_c(name, run_command):
    done = run_command([], before=TOLD_TO_END.format(name=name))
    assert (done.returncode, done.stdout) == (128 + getattr(signal, name), "kept\n")
    assert done.stderr == "stkzoo: interrupted\n"


def test_a_file_that_cannot_be_used_is_one_sentence(tmp_path, monkeypatch, capsys):
    folder = tmp_path / "lock\x1b[2J"
    folder.mkdir()

    def read(arguments: TracksArguments):  # noqa: ARG001 - it is a command
        folder.read_text()

    monkeypatch.setattr("stkzoo.cli.tracks.run", read)
    assert main(["tracks"]) == 1
    assert run_training("rate", "", folder.read_text, (), []) == 1
    for line in capsys.readouterr().err.splitlines():
        assert re.fullmatch(r".*: /.*/lock\?\[2J cannot be used: Is a directory; move .*", line)
