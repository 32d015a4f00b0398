"""The command line is made of its modules: a new module is a new command."""

from pathlib import Path

import pytest

import stkzoo.cli
from stkzoo.cli import COMMANDS, build_parser, main

MODULES = sorted(Path(stkzoo.cli.__file__).parent.glob("[!_]*.py"))


def test_each_public_module_is_a_command():
    assert sorted(COMMANDS) == sorted(module.stem.replace("_", "-") for module in MODULES)


def test_the_help_lists_each_command_with_its_summary(capsys):
    assert main(["--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, summary in [("keys", "make keys for networked races"), ("karts", "list the karts")]:
        assert f"{name} {summary}" in shown


@pytest.mark.parametrize("command", COMMANDS)
def test_only_the_arguments_of_the_command_at_hand_are_declared(command):
    (subparsers,) = (action for action in build_parser(command)._actions if action.choices)
    declared = [name for name, child in subparsers.choices.items() if child.get_default("fail")]
    assert declared == [command]


def test_an_unknown_command_is_a_usage_error(capsys):
    assert main(["tournement"]) == 2
    assert "tournament" in capsys.readouterr().err
