"""What the commands of this package share: options of dataclasses, libraries, and a bar."""

from __future__ import annotations

import argparse
import importlib
import json
from collections.abc import Collection, Mapping
from dataclasses import MISSING, asdict, fields
from pathlib import Path
from typing import Any

from stkzoo._os import atomic_write
from stkzoo.errors import ConfigError

__all__ = [
    "ARGUMENTS",
    "RunBar",
    "add_arguments",
    "changes",
    "keep_arguments",
    "keep_to_one_thread",
    "training_library",
    "training_torch",
    "values_of",
]

#: The file in a run's folder that says what the run is made of.
ARGUMENTS = "arguments.json"


def add_arguments(parser: argparse.ArgumentParser, kind: Any) -> None:
    """Adds an option for each field of a dataclass; its docstring's lines are their help.

    Args:
        parser: gets them.
        kind: a dataclass whose fields all have defaults: numbers, words, truths, or tuples of the
            first two.
    """
    lines = [line.strip().partition(": ") for line in (kind.__doc__ or "").splitlines()]
    about = {name: text.rstrip(".").replace("%", "%%") for name, _, text in lines}
    for entry in fields(kind):
        default = entry.default
        assert default is not MISSING  # noqa: S101 - see above
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else default
        has_default = not isinstance(default, bool) and shown != ""
        told = f"{about[entry.name]} ({shown})" if has_default else about[entry.name]
        flag = "--" + entry.name.replace("_", "-")
        if isinstance(default, bool):
            parser.add_argument(flag, action="store_true", help=told)
        elif isinstance(default, tuple):
            one = type(default[0])
            parser.add_argument(flag, type=one, nargs="+", default=default, help=told)
        else:
            parser.add_argument(flag, type=type(default), default=default, help=told)


def values_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """The fields' values of options that were read; lists become tuples."""
    return {name: tuple(v) if isinstance(v, list) else v for name, v in options.items()}


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Says which fields are other now than in a file of JSON; empty if none is."""
    now = json.loads(json.dumps(now))
    others = [name for name in now if before.get(name) != now[name]]
    return ", ".join(f"{n} was {before.get(n)!r}, now {now[n]!r}" for n in others)


def keep_arguments(folder: Path, arguments: Any, free: Collection[str] = ()) -> None:
    """Notes what a new run is made of, or checks that the one that is there is made of the same.

    Args:
        folder: the run's; it is made.
        arguments: a dataclass.
        free: names of its fields that may be others when a run goes on, and are not noted.

    Raises:
        ConfigError: the folder has another run.
    """
    now = {name: value for name, value in asdict(arguments).items() if name not in free}
    file = folder / ARGUMENTS
    if file.exists():
        if told := changes(json.loads(file.read_text()), now):
            raise ConfigError(
                f"the run in {str(folder)!r} has other arguments: {told}; give the same, or "
                "another --output"
            )
        return
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(file) as part:
        part.write_text(json.dumps(now, indent=1) + "\n")


def training_library(name: str) -> Any:
    """Imports a library of ``stkzoo[train]``.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(f"learning needs {error.name}; pip install 'stkzoo[train]'") from error


def keep_to_one_thread() -> None:
    """Keeps the numerical libraries that are loaded to one thread.

    The networks are small: a second thread only takes the core that the games need.

    Raises:
        ConfigError: the library for it is not installed.
    """
    training_library("threadpoolctl").threadpool_limits(1)


def training_torch() -> Any:
    """Imports torch, which keeps to one thread.

    Raises:
        ConfigError: it is not installed.
    """
    torch = training_library("torch")
    torch.set_num_threads(1)
    keep_to_one_thread()
    return torch


class RunBar:
    """How many kart-steps a run has done, on a terminal's stderr.

    Args:
        until: how many there shall be.
        done: how many there are.

    Attributes:
        is_shown: whether there is a terminal.
    """

    def __init__(self, until: int, done: int = 0) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        console = Console(stderr=True)
        self.is_shown = console.is_terminal
        self._bar = Progress(
            TextColumn("{task.completed:,.0f} kart-steps"),
            BarColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[last]}"),
            console=console,
            disable=not self.is_shown,
        )
        self._task = self._bar.add_task("", total=until, completed=done, last="")
        self._bar.start()

    def show(self, done: float, text: str) -> None:
        """Moves the bar."""
        self._bar.update(self._task, completed=done, last=text)

    def stop(self) -> None:
        """Takes the bar away."""
        self._bar.stop()
