"""Shared terminal output of commands: lines, tables and progress bars."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from typing import Any

import rich.progress
from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

from stkzoo.engine.assets import Progress
from stkzoo.race.document import Document

#: Width of a console whose lines can have any length.
_UNLIMITED = 10_000
#: Minimum time between two lines about the same stage without a terminal [s].
_QUIET_INTERVAL = 10.0
#: Time over which a bar measures its speed [s]; races of a batch end in groups.
_SPEED_PERIOD = 3600.0


@dataclass
class JsonArguments:
    """Options of commands that only show facts.

    Attributes:
        json: write JSON instead of a table
    """

    json: bool = False


def make_console() -> Console:
    """Returns a console on stdout that does not convert names such as ``:fire:`` to emoji.

    In a file or pipe, lines can have any length.
    """
    console = Console(emoji=False)
    if not console.is_terminal:
        console.width = _UNLIMITED
    return console


def counted(number: int, noun: str) -> str:
    """Returns a number and a noun, which gets an ``s`` unless the number is 1."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def say(text: str, console: Console | None = None) -> None:
    """Prints a text without wrapping, markup and emoji conversion.

    Args:
        text: the text.
        console: where to print; stdout by default.
    """
    console = console or make_console()
    console.print(text, highlight=False, markup=False, soft_wrap=True, emoji=False)


def show(value: Any, as_text: Callable[[Any], object], *, as_json: bool) -> None:
    """Prints a result as text or JSON.

    Args:
        value: the result: a document, or documents or other dataclasses in lists and dicts.
        as_text: function that prints it as text.
        as_json: whether to print JSON.
    """
    if not as_json:
        as_text(value)
    elif isinstance(value, Document):
        print(value.to_json())
    else:
        print(json.dumps(value, indent=2, default=_to_dict))


def _to_dict(value: Any) -> Any:
    return json.loads(value.to_json()) if isinstance(value, Document) else asdict(value)


def show_facts(facts: Sequence[Mapping[str, object]], **options: Any) -> None:
    """Prints a table with a column for each name.

    Args:
        facts: values by name; all have the same names.
        **options: as for :func:`show_table`.
    """
    columns = [name.replace("_", " ") for name in facts[0]]
    show_table(columns, (tuple(fact.values()) for fact in facts), **options)


def show_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    styles: Iterable[str | None] = (),
    title: str = "",
) -> None:
    """Prints a table of results on stdout.

    In a file or pipe, each row is one line. On a terminal, the table has a frame if there is space
    for it, and cells wrap between words. Words are never cut: if they do not fit, lines are longer
    than the terminal is wide.

    Args:
        columns: headings of the columns.
        rows: cells of each row: texts; numbers, which are shown with at most two decimals and
            right-aligned; and ``None``, shown as ``-``.
        styles: style of each row.
        title: line above the table.
    """
    console = make_console()
    table = Table(box=box.ROUNDED, title=escape(title))
    rows = [*rows]
    for number, name in enumerate(columns):
        cells = [row[number] for row in rows]
        is_text = all(isinstance(cell, str | None) for cell in cells)
        words = [word for text in (name, *map(_text, cells)) for word in text.split()]
        table.add_column(
            escape(name),
            justify="left" if is_text else "right",
            min_width=max(map(cell_len, words), default=0),
        )
    for row, style in zip_longest(rows, styles):
        table.add_row(*(escape(_text(cell)) for cell in row), style=style)
    whole = Measurement.get(console, console.options.update(width=_UNLIMITED), table)
    if not console.is_terminal or whole.maximum > console.width:
        table.box, table.pad_edge = None, False
    console.print(table, crop=False)


def _text(cell: object) -> str:
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, int):
        return f"{cell:,}"
    return "-" if cell is None else f"{cell:,.2f}" if isinstance(cell, float) else str(cell)


class Bars(rich.progress.Progress):
    """A progress bar on stderr. Without a terminal, a line of text at most every 10 s."""

    def __init__(self) -> None:
        console = Console(stderr=True)
        super().__init__(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[text]}", markup=False),
            TimeRemainingColumn(),
            console=console,
            speed_estimate_period=_SPEED_PERIOD,
            transient=True,
            disable=not console.is_terminal,
        )
        self._spoken = time.monotonic()

    def begin(self, stage: str, total: float | None = None) -> None:
        """Starts a bar in place of the last one.

        Args:
            stage: what it shows.
            total: amount of work; ``None`` if unknown.
        """
        for task in self.tasks:
            self.remove_task(task.id)
        self.add_task(stage, total=total, text="")
        self._spoken = time.monotonic()

    def show(self, done: float, text: str, total: float | None = None) -> None:
        """Updates the bar, or prints a line if there is no terminal and the last one was 10 s ago.

        Args:
            done: complete work.
            text: text beside the bar.
            total: amount of work; ``None`` if it has not changed.
        """
        (task,) = self.tasks
        self.update(task.id, completed=done, total=total, text=text)
        if self.disable and time.monotonic() - self._spoken > _QUIET_INTERVAL:
            say(f"{task.description}: {text}", self.console)
            self._spoken = time.monotonic()


class ConsoleProgress(Bars, Progress):
    """Shows the stages of an installation, which have sizes in bytes."""

    def begin(self, stage: str, total: float | None = None) -> None:
        """Starts a bar for a stage; without a terminal, also prints a line about it."""
        self._size = f" of {megabytes(total)}" if total else ""
        super().begin(stage, total)
        if self.disable:
            self.note(stage + self._size)

    def reach(self, done: int) -> None:
        """Updates the bar."""
        self.show(done, megabytes(done) + self._size)

    def note(self, text: str) -> None:
        """Prints a line of text."""
        say(text, self.console)


def megabytes(size: float) -> str:
    """Returns a size [bytes] as text in megabytes."""
    return f"{size / 1e6:,.0f} MB"
