"""What the commands write with: a table style and a progress bar."""

from __future__ import annotations

import time
from types import TracebackType

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)
from rich.progress import Progress as Bars

from stkzoo.engine.assets import Progress

__all__ = ["ConsoleProgress", "megabytes"]

#: Without a terminal, one line at most in so many seconds for a stage under way.
_QUIET_INTERVAL = 10.0


class ConsoleProgress(Progress):
    """Draws a bar for each stage on stderr; without a terminal, a line now and then."""

    def __init__(self) -> None:
        self._console = Console(stderr=True)
        self._bars: Bars | None = None
        self._task: TaskID | None = None
        self._stage, self._total = "", 0
        self._spoken = time.monotonic()

    def __enter__(self) -> ConsoleProgress:
        if self._console.is_terminal:
            self._bars = Bars(
                TextColumn("{task.description}"),
                BarColumn(),
                DownloadColumn(),
                TransferSpeedColumn(),
                TimeRemainingColumn(),
                console=self._console,
            )
            self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self._finish()
        if self._bars is not None:
            self._bars.stop()

    def begin(self, stage: str, total: int | None = None) -> None:
        """Starts a bar, or writes a line."""
        self._finish()
        self._stage, self._total = stage, total or 0
        self._spoken = time.monotonic()
        if self._bars is not None:
            self._task = self._bars.add_task(stage, total=total)
        else:
            self.note(stage + (f" ({megabytes(total)})" if total else ""))

    def reach(self, done: int) -> None:
        """Moves the bar."""
        if self._bars is not None and self._task is not None:
            self._bars.update(self._task, completed=done)
        elif time.monotonic() - self._spoken > _QUIET_INTERVAL:
            self._spoken = time.monotonic()
            of = f" of {megabytes(self._total)}" if self._total else ""
            self.note(f"{self._stage}: {megabytes(done)}{of}")

    def note(self, text: str) -> None:
        """Writes a line."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _finish(self) -> None:
        if self._bars is not None and self._task is not None:
            task = self._bars.tasks[self._task]
            total = task.total or task.completed or 1
            self._bars.update(self._task, total=total, completed=total)


def megabytes(size: float) -> str:
    """A size [bytes] in words."""
    return f"{size / 1e6:,.0f} MB"
