"""Terminal output that several commands share: lines, tables and progress bars."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Sequence
from itertools import zip_longest
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.markup import escape
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


def make_console() -> Console:
    """A console on stdout. It shows names such as ``:fire:`` as they are."""
    return Console(emoji=False)


def say(text: str, console: Console | None = None) -> None:
    """Prints a text as it is, without wrapping and markup."""
    console = console or make_console()
    console.print(text, highlight=False, markup=False, soft_wrap=True, emoji=False)


def show_table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    left: Collection[str],
    styles: Iterable[str | None] = (),
    console: Console | None = None,
    is_narrow: bool = False,
    **options: Any,
) -> None:
    """Prints a table of results: framed on a terminal, bare in a file.

    Where it is too wide, texts wrap; numbers stay whole.

    Args:
        columns: headings.
        rows: the texts of each row.
        left: headings of columns of text; the others are numbers, and aligned right.
        styles: each row's.
        console: where to print.
        is_narrow: draw no frame, because the terminal has no room for it.
        **options: of ``rich.table.Table``.
    """
    console = console or make_console()
    is_framed = console.is_terminal and not is_narrow
    table = Table(box=box.ROUNDED if is_framed else None, pad_edge=is_framed, **options)
    for name in columns:
        justify: Literal["left", "right"] = "left" if name in left else "right"
        table.add_column(escape(name), justify=justify, overflow="fold", no_wrap=name not in left)
    for row, style in zip_longest(rows, styles):
        table.add_row(*map(escape, row), style=style)
    console.print(table)


def make_bars(*columns: ProgressColumn | str, vanish: bool = True) -> Bars:
    """Bars on stderr, which vanish when they end; nothing without a terminal."""
    console = Console(stderr=True)
    return Bars(*columns, console=console, transient=vanish, disable=not console.is_terminal)


#: Without a terminal, seconds between two lines about the same stage.
_QUIET_INTERVAL = 10.0


class ConsoleProgress(Progress):
    """Draws a bar for each stage on stderr; without a terminal, prints a line now and then."""

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
        self._spoken = time.monotonic()

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._finish()
        self._bars.stop()

    def begin(self, stage: str, total: int | None = None) -> None:
        """Starts a bar, or prints a line."""
        self._finish()
        self._bars.add_task(stage, total=total)
        self._stage = self._bars.tasks[-1]
        self._spoken = time.monotonic()
        if self._bars.disable:
            self.note(stage + (f" ({megabytes(total)})" if total else ""))

    def reach(self, done: int) -> None:
        """Moves the bar."""
        stage = self._stage
        if stage is None:
            return
        self._bars.update(stage.id, completed=done)
        if self._bars.disable and time.monotonic() - self._spoken > _QUIET_INTERVAL:
            self._spoken = time.monotonic()
            of = f" of {megabytes(stage.total)}" if stage.total else ""
            self.note(f"{stage.description}: {megabytes(done)}{of}")

    def note(self, text: str) -> None:
        """Prints a line."""
        say(text, self._bars.console)

    def _finish(self) -> None:
        if self._stage is not None:
            total = self._stage.total or self._stage.completed or 1
            self._bars.update(self._stage.id, total=total, completed=total)


def megabytes(size: float) -> str:
    """A size [bytes] as text."""
    return f"{size / 1e6:,.0f} MB"
