"""Each module of the command line is a command."""

import argparse
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import stkzoo.cli
from stkzoo.cli import COMMANDS, build_parser, main
from tests.support.processes import run_program

MODULES = sorted(Path(stkzoo.cli.__file__).parent.glob("[!_]*.py"))


def test_each_public_module_is_a_command():
    assert sorted(COMMANDS) == sorted(module.stem.replace("_", "-") for module in MODULES)


def test_the_help_lists_each_command_with_its_summary(capsys):
    assert main(["--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, summary in [("keys", "make keys for networked races"), ("karts", "list the karts")]:
        assert f"{name} {summary}" in shown


def parsers(parser, name="stkzoo"):
    yield name, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for word, child in action.choices.items():
                yield from parsers(child, f"{name} {word}")


def test_the_help_of_each_command_fits_80_columns(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    for name, parser in parsers(build_parser()):
        lines = parser.format_help().splitlines()
        assert max(map(len, lines)) <= 80, name
        assert len(parser.format_usage().splitlines()) <= 3, name


def test_a_long_help_shows_examples_first_and_groups_of_options():
    for name in ("race", "race-client", "tournament", "benchmark", "demos", "play"):
        text = dict(parsers(build_parser(name)))[f"stkzoo {name}"].format_help()
        assert text.startswith(f"usage: stkzoo {name} [OPTION ...] ")
        assert text.index("examples:") < text.index("options:") < text.index("output:")
        assert max(len(group.splitlines()) for group in text.split("\n\n")) < 42


@pytest.mark.parametrize("command", COMMANDS)
def test_only_the_arguments_of_the_given_command_are_declared(command):
    (subparsers,) = (action for action in build_parser(command)._actions if action.choices)
    declared = [name for name, child in subparsers.choices.items() if child.get_default("fail")]
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


@pytest.mark.parametrize(
    "words", [["tracks", "olivermath"], ["karts", "--json"], ["race", "--help"]]
)
def test_a_closed_pipe_causes_no_traceback(words):
    program = subprocess.Popen(
        [sys.executable, "-c", "import sys, stkzoo.cli; sys.exit(stkzoo.cli.main())", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    program.stdout.close()
    with program.stderr:
        assert program.stderr.read() == b""
    assert program.wait() in (0, 1)  # argparse ignores the broken pipe


def test_a_command_sees_exit_codes_although_its_parent_ignored_its_children():
    code = """
        import signal, subprocess, sys
        from stkzoo.cli import main
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        main(["--version"])
        print(subprocess.run([sys.executable, "-c", "raise SystemExit(3)"]).returncode)
    """
    assert run_program(code).stdout.splitlines()[-1] == "3"


ENDED = """
    import os, signal, sys, time
    from stkzoo import cli

    signal.signal(getattr(signal, sys.argv[1]), signal.SIG_DFL)  # the tests may run with nohup

    def command(words):
        try:
            os.kill(os.getpid(), getattr(signal, words[0]))
            time.sleep(60)
        finally:
            print("kept", flush=True)
            for again in words[1:]:
                time.sleep(float(again))
                os.kill(os.getpid(), getattr(signal, words[0]))
        return 0

    cli._exit_code = command
    sys.exit(cli.main(sys.argv[1:]))
"""


def ended(*words, **options):
    program = [sys.executable, "-c", textwrap.dedent(ENDED), *words]
    return subprocess.run(program, capture_output=True, text=True, timeout=60, **options)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_command_that_is_told_to_end_stops_like_after_ctrl_c(name):
    done = ended(name)
    assert (done.returncode, done.stdout) == (128 + getattr(signal, name), "kept\n")
    assert done.stderr == "stkzoo: interrupted\n"


def test_an_interrupt_while_a_class_is_made_is_reported_as_an_interrupt(monkeypatch, capsys):
    """Imports make classes. Python up to 3.11 raises a RuntimeError."""

    class Interrupting:
        def __set_name__(self, owner, name):
            raise KeyboardInterrupt

    monkeypatch.setattr(stkzoo.cli, "_exit_code", lambda _: type("C", (), {"x": Interrupting()}))
    assert main(["karts"]) == 130
    assert capsys.readouterr().err == "stkzoo: interrupted\n"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_the_second_signal_ends_a_command_at_once_but_not_the_echo_of_the_first():
    assert ended("SIGTERM", "0").returncode == 128 + signal.SIGTERM
    assert ended("SIGTERM", "1.2").returncode == -signal.SIGTERM


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_a_closed_terminal_does_not_disturb_the_end_of_a_command(tmp_path):
    import fcntl
    import pty
    import termios

    file = tmp_path / "kept"
    program = f"""
        import signal, sys, time
        from pathlib import Path
        from stkzoo import cli

        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run with nohup

        def command(_):
            try:
                print("ready", flush=True)
                time.sleep(60)
            finally:
                print("interrupted", file=sys.stderr, flush=True)
                Path({str(file)!r}).touch()

        cli._exit_code = command
        sys.exit(cli.main([]))
    """
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )
    os.close(theirs)
    assert os.read(ours, 5) == b"ready"
    os.close(ours)
    assert process.wait(30) == 128 + signal.SIGHUP
    assert file.exists()
