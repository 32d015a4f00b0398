"""Shared parts of the training commands: options, errors, progress bar, libraries."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

from stkzoo._arguments import CommandParser, add_options, values_of
from stkzoo._imports import import_extra
from stkzoo._os import sentence_of
from stkzoo.errors import StkzooError


def command_parser(module: str, description: str | None, kinds: Sequence[type]) -> CommandParser:
    """Returns the parser of a command; see :func:`run_command` for the arguments."""
    commands = {"league": "stkzoo league"}
    prog = commands.get(module, f"python -m stkzoo.agents.training.{module}")
    parser = CommandParser(prog=prog, description=description)
    for options in kinds:
        add_options(parser, options)
    return parser


def run_command(
    module: str,
    description: str | None,
    run: Callable[..., object],
    kinds: Sequence[type],
    words: list[str] | None,
    if_interrupted: str = "",
) -> int:
    """Runs ``python -m stkzoo.agents.training.MODULE``; reports errors and Ctrl-C on stderr.

    Args:
        module: name of the module below this package; ``league`` runs as ``stkzoo league``.
        description: docstring of the module.
        run: function of the command; called with an instance of each of ``kinds``.
        kinds: dataclasses; each field is an option.
        words: command line; ``None`` for that of the process.
        if_interrupted: advice after Ctrl-C.

    Returns:
        The exit code.
    """
    values = command_parser(module, description, kinds).parse_args(words)
    try:
        run(*(options(**values_of(values, options)) for options in kinds))
    except (StkzooError, OSError) as error:
        print(f"error: {sentence_of(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted" + (if_interrupted and f"; {if_interrupted}"), file=sys.stderr)
        return 130
    return 0


class ProgressBar:
    """Shows the progress of a run on stderr if that is a terminal.

    Args:
        total: total work.
        done: work done so far.
        unit: unit of work.

    Attributes:
        is_shown: whether there is a terminal.
    """

    def __init__(self, total: int, done: int = 0, unit: str = "kart-steps") -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        console = Console(stderr=True)
        self.is_shown = console.is_terminal
        self._progress = Progress(
            TextColumn("{task.completed:,.0f} " + unit),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.description}"),
            console=console,
            disable=not self.is_shown,
        )
        self._task = self._progress.add_task("", total=total, completed=done)

    def __enter__(self) -> ProgressBar:
        self._progress.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._progress.stop()

    def show(self, done: float, text: str, total: int | None = None) -> None:
        """Updates the bar.

        Args:
            done: work done so far.
            text: current task or latest result.
            total: new total work; ``None`` keeps it.
        """
        self._progress.update(self._task, completed=done, description=text, total=total)

    def report(self, done: float, text: str) -> None:
        """Updates the bar; without a terminal, prints a line."""
        self.show(done, text)
        if not self.is_shown:
            print(f"{done:>10,.0f}  {text}", flush=True)


def training_library(name: str) -> Any:
    """Imports a library of the extra ``train``.

    Raises:
        ConfigError: the library is not installed.
    """
    return import_extra(name, "learning needs", "train")


def limit_threads() -> None:
    """Limits the loaded numerical libraries to one thread.

    The networks are small; further threads would compete with the games.

    Raises:
        ConfigError: the library that sets the limit is not installed.
    """
    training_library("threadpoolctl").threadpool_limits(1)


def training_torch() -> Any:
    """Imports PyTorch and limits it to one thread.

    Raises:
        ConfigError: PyTorch is not installed.
    """
    torch = training_library("torch")
    torch.set_num_threads(1)
    limit_threads()
    return torch
