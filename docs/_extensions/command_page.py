"""Builds the reference page of the commands from their parsers."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Iterator
from typing import Any

from stkzoo.agents.training.common.command import command_parser
from stkzoo.agents.training.league import league
from stkzoo.cli import COMMANDS, build_parser

_HEAD = """\
# Commands and options

This page lists the options that `stkzoo COMMAND --help` shows. For an overview, exit codes and
completion, see [The command line](cli.md).
"""


def pages() -> dict[str, str]:
    """Returns the text of the page."""
    subparsers = _actions_of(build_parser())
    assert subparsers is not None  # noqa: S101 - each command is one
    parsers = dict(subparsers.choices)
    kinds = (league.LeagueOptions, league.LeagueArguments)
    parsers["league"] = command_parser("league", league.__doc__, kinds)
    lines = [line for name in COMMANDS for line in _section(parsers[name], 2)]
    return {"reference/commands.md": "\n".join([_HEAD, *lines]).rstrip() + "\n"}


def _section(parser: argparse.ArgumentParser, level: int) -> Iterator[str]:
    yield from ("#" * level + " " + parser.prog, "")
    for part in _plain(parser.description or "").split("\n\n"):
        if re.search("^ ", part, re.MULTILINE):
            title, _, lines = (
                part.partition("\n") if part.startswith("examples:") else ("", "", part)
            )
            yield from ([title.capitalize(), ""] if title else [])
            yield from ("```text", textwrap.dedent(lines), "```", "")
        else:
            yield from (" ".join(part.split()), "")
    for group in parser._action_groups:
        if rows := [row for action in group._group_actions for row in _row(parser, action)]:
            yield from (f"| {group.title} | |", "| --- | --- |", *rows, "")
    if actions := _actions_of(parser):
        for child in actions.choices.values():
            yield from _section(child, level + 1)


def _row(parser: argparse.ArgumentParser, action: argparse.Action) -> Iterator[str]:
    if isinstance(action, (argparse._HelpAction, argparse._SubParsersAction)):
        return
    if action.help == argparse.SUPPRESS:
        return
    shown = parser._get_formatter()
    default = (action.option_strings or [action.metavar or action.dest])[0].lstrip("-").upper()
    values = "" if action.nargs == 0 else shown._format_args(action, default)
    names = [f"{name} {values}".rstrip() for name in action.option_strings] or [values]
    text = shown._expand_help(action) if action.help else ""
    yield f"| {', '.join(f'`{name}`' for name in names)} | {text} |"


def _actions_of(parser: argparse.ArgumentParser) -> argparse._SubParsersAction[Any] | None:
    found = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    return found[0] if found else None


def _plain(text: str) -> str:
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
