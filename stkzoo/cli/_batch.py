"""Runs a batch of races for a command: progress bar, errors, interruption."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from stkzoo.cli._console import make_bars, say
from stkzoo.evaluation import BatchError, BatchProgress, RunOptions

_INTERRUPTED = 130

Result = TypeVar("Result")


def run_batch(
    arguments: argparse.Namespace, run: Callable[[RunOptions], Result], resume: str
) -> tuple[Result | None, int]:
    """Runs a batch with a progress bar.

    Args:
        arguments: of the command, with ``jobs`` and ``race_timeout``.
        run: runs the batch.
        resume: how to resume it after an interruption.

    Returns:
        The result, and the exit code. The result is ``None`` if there is nothing to show.
    """
    done = total = 0
    with make_bars(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}"),
    ) as bars:
        task = bars.add_task("races", total=None, last="")

        def update(progress: BatchProgress) -> None:
            nonlocal done, total
            done, total, last = progress.done, progress.total, progress.last
            text = f"{last.track}: {escape(last.agents[0].driver)}" if last else ""
            bars.update(task, completed=done, total=total, last=text)

        try:
            plots = not getattr(arguments, "no_plot", False)
            options = RunOptions(arguments.jobs, arguments.race_timeout, update, plots)
            return run(options), 0
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            return error.result, 1
        except KeyboardInterrupt:
            print(
                f"stkzoo: interrupted after {done} of {total} races, which are kept; resume with: "
                f"{resume}",
                file=sys.stderr,
            )
            return None, _INTERRUPTED


def say_kept(folder: Path, *names: str) -> None:
    """Names the files that a batch has left in its folder."""
    kept = ", ".join(name for name in names if (folder / name).exists())
    say(f"More in {folder}{os.sep}: {kept}")
