"""Shared terminal output of commands: lines, tables and progress bars."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Sequence
from itertools import zip_longest

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    DownloadColumn,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.progress import Progress as Bars
from rich.table import Table
from typing_extensions import Self  # a dependency of gymnasium

from stkzoo.engine.assets import Progress

#: Width of a console whose lines can have any length.
_UNLIMITED = 10_000


def make_console() -> Console:
    """Returns a console on stdout that does not convert names such as ``:fire:`` to emoji.

    In a file or pipe, lines can have any length.
    """
    console = Console(emoji=False)
    if not console.is_terminal:
        console.width = _UNLIMITED
    return console


def say(text: str, console: Console | None = None) -> None:
    """Prints a text without wrapping, markup and emoji conversion.

    Args:
        text: the text.
        console: where to print; stdout by default.
    """
    console = console or make_console()
    console.print(text, highlight=False, markup=False, soft_wrap=True, emoji=False)


def show_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    left: Collection[str],
    styles: Iterable[str | None] = (),
    title: str = "",
    caption: str = "",
    console: Console | None = None,
) -> None:
    """Prints a table of results.

    In a file or pipe, each row is one line. On a terminal, the table has a frame if there is space
    for it, and texts wrap between words. Numbers and words are never cut: if they do not fit, lines
    are longer than the terminal is wide.

    Args:
        columns: headings of the columns.
        rows: texts of each row.
        left: headings of columns with text. Other columns contain numbers and are right-aligned.
        styles: style of each row.
        title: line above the table.
        caption: line below the table.
        console: where to print; stdout by default.
    """
    console = console or make_console()
    rows = list(rows)
    table = Table(box=box.ROUNDED, title=escape(title), caption=escape(caption))
    for number, name in enumerate(columns):
        lines = [line for row in rows for line in row[number].splitlines()]
        parts = " ".join(lines).split() if name in left else lines
        table.add_column(
            escape(name),
            justify="left" if name in left else "right",
            min_width=max(map(cell_len, ["", *name.split(), *parts])),
        )
    for row, style in zip_longest(rows, styles):
        table.add_row(*map(escape, row), style=style)
    whole = Measurement.get(console, console.options.update(width=_UNLIMITED), table)
    if not console.is_terminal or whole.maximum > console.width:
        table.box, table.pad_edge = None, False
    console.print(table, crop=False)


def make_bars(*columns: ProgressColumn | str, vanish: bool = True) -> Bars:
    """Returns progress bars on stderr, which are disabled without a terminal.

    Args:
        *columns: columns of the bars.
        vanish: whether the bars are removed when they end.
    """
    console = Console(stderr=True)
    return Bars(*columns, console=console, transient=vanish, disable=not console.is_terminal)


#: Minimum time between two lines about the same stage without a terminal [s].
_QUIET_INTERVAL = 10.0


class QuietLines:
    """Decides when to print a line of progress instead of disabled bars: at most every 10 s.

    Args:
        bars: the bars.
    """

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self.restart()

    def restart(self) -> None:
        """Starts the interval again."""
        self._spoken = time.monotonic()

    def are_due(self) -> bool:
        """Returns whether to print a line now, which starts the interval again."""
        is_due = self._bars.disable and time.monotonic() - self._spoken > _QUIET_INTERVAL
        if is_due:
            self.restart()
        return is_due


class ConsoleProgress(Progress):
    """Shows a progress bar for each stage on stderr; prints lines if there is no terminal."""

    def __init__(self) -> None:
        self._bars = make_bars(
            TextColumn("{task.description}"),
            BarColumn(),
            DownloadColumn(),
            TransferSpeedColumn(),
            TimeRemainingColumn(),
            vanish=False,
        )
        self._stage: Task | None = None
        self._lines = QuietLines(self._bars)

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._finish()
        self._bars.stop()

    def begin(self, stage: str, total: int | None = None) -> None:
        """Starts a bar for a stage, or prints a line about it."""
        self._finish()
        self._bars.add_task(stage, total=total)
        self._stage = self._bars.tasks[-1]
        self._lines.restart()
        if self._bars.disable:
            self.note(stage + (f" ({megabytes(total)})" if total else ""))

    def reach(self, done: int) -> None:
        """Updates the bar, or prints a line if the last one was 10 s ago."""
        stage = self._stage
        if stage is None:
            return
        self._bars.update(stage.id, completed=done)
        if self._lines.are_due():
            of = f" of {megabytes(stage.total)}" if stage.total else ""
            self.note(f"{stage.description}: {megabytes(done)}{of}")

    def note(self, text: str) -> None:
        """Prints a line of text."""
        say(text, self._bars.console)

    def _finish(self) -> None:
        if self._stage is not None:
            total = self._stage.total or self._stage.completed or 1
            self._bars.update(self._stage.id, total=total, completed=total)


def megabytes(size: float) -> str:
    """Returns a size [bytes] as text in megabytes."""
    return f"{size / 1e6:,.0f} MB"
