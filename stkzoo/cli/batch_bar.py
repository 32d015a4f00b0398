"""How far a batch of races has come."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self  # a part of gymnasium

    from stkzoo.evaluation import BatchProgress

__all__ = ["BatchBar"]


class BatchBar:
    """The races done, on a terminal's stderr.

    Attributes:
        done: races that have been run.
        total: races in all.
    """

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeRemainingColumn,
        )

        console = Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[last]}"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bars.add_task("races", total=None, last="")
        self.done = self.total = 0

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Takes the bar away."""
        self._bars.stop()

    def tell(self, progress: BatchProgress) -> None:
        """Moves the bar."""
        from rich.markup import escape

        self.done, self.total = progress.done, progress.total
        last = progress.last
        text = f"{last.track}: {escape(last.agents[0].driver)}" if last else ""
        self._bars.update(self._task, completed=self.done, total=self.total, last=text)
