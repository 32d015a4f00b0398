"""Runs batches of races for commands, with a progress bar and error messages."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from stkzoo._locks import LOCK
from stkzoo.cli._arguments import AGENT_FAILED, INTERRUPTED
from stkzoo.cli._console import QuietLines, make_bars, say
from stkzoo.cli._race_report import show_errors
from stkzoo.evaluation import BatchError, BatchProgress, RunOptions
from stkzoo.evaluation.batch.order import RACES
from stkzoo.evaluation.batch.plan import PLAN_FILE
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

#: Leading dots, and characters that separate folders or are invalid in names on some systems.
_UNSAFE = re.compile(r"^\.+|[/\\<>\"|?*]")

Result = TypeVar("Result")
AnyDocument = TypeVar("AnyDocument", bound=Document)


def run_batch(
    arguments: argparse.Namespace, run: Callable[[RunOptions], Result], *, is_saved: bool = True
) -> tuple[Result | None, int]:
    """Runs a batch with a progress bar, or lines of progress if there is no terminal.

    Args:
        arguments: arguments of the command, with ``jobs`` and ``race_timeout``.
        run: function that runs the batch.
        is_saved: whether the batch saves each race, so that the same command resumes it.

    Returns:
        The result and the exit code. The result is ``None`` if there is no result to show.
    """
    done = total = 0
    with make_bars(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[last]}", markup=False),
    ) as bars:
        task, lines = bars.add_task("races", total=None, last=""), QuietLines(bars)

        def update(progress: BatchProgress) -> None:
            nonlocal done, total
            done, total, last = progress.done, progress.total, progress.last
            text = f"{last.track}: {last.agents[0].driver}" if last else ""
            bars.update(task, completed=done, total=total, last=text)
            if lines.are_due():
                say(f"{done} of {total} races  {text}".rstrip(), bars.console)

        try:
            plots = not getattr(arguments, "no_plot", False)
            options = RunOptions(arguments.jobs, arguments.race_timeout, update, plots)
            return run(options), 0
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            return error.result, 1
        except KeyboardInterrupt:
            saved = f"{done} of {total} races are saved; run the same command to resume"
            text = saved if is_saved and total else "nothing was saved"
            print(f"stkzoo: interrupted; {text}", file=sys.stderr)
            return None, INTERRUPTED


def run_replays(
    arguments: argparse.Namespace, run: Callable[..., Result]
) -> tuple[Result | None, int]:
    """Runs recorded races again with a progress bar.

    Args:
        arguments: see :func:`run_batch`.
        run: function that runs the races, with arguments ``jobs``, ``race_timeout``, ``on_race``.

    Returns:
        See :func:`run_batch`.
    """

    def rerun(options: RunOptions) -> Result:
        return run(jobs=options.jobs, race_timeout=options.race_timeout, on_race=options.on_race)

    return run_batch(arguments, rerun, is_saved=False)


def file_name(label: str) -> str:
    """Converts the label of an agent, which its code may choose, to the name of a file or folder.

    Args:
        label: the label.

    Returns:
        A name without path separators that is not ``.`` or ``..``.
    """
    return _UNSAFE.sub("_", label).replace(":", "-")


def run_and_show(
    arguments: argparse.Namespace,
    run: Callable[[RunOptions], AnyDocument],
    folder: Path,
    show: Callable[[AnyDocument], object],
    agent: str = "",
) -> int:
    """Runs a batch and shows its result.

    Args:
        arguments: arguments of the command, with ``jobs``, ``race_timeout`` and ``json``.
        run: function that runs the batch.
        folder: folder of the batch.
        show: function that prints the result.
        agent: name of the agent whose first failure is shown; empty for none.

    Returns:
        The exit code.
    """
    result, code = run_batch(arguments, run)
    if result is None:
        return code
    has_failed = bool(getattr(result, "errors", 0))
    if arguments.json:
        print(result.to_json())
    else:
        show(result)
        if agent and has_failed:
            _show_first_failure(folder, agent)
        files = sorted({path.name for path in folder.iterdir()} - {PLAN_FILE, LOCK})
        say(f"More in {folder}{os.sep}: {', '.join(files)}")
    return code or (AGENT_FAILED if has_failed else 0)


def _show_first_failure(folder: Path, agent: str) -> None:
    """Prints why an agent failed in the first race in which it did."""
    for file in sorted((folder / RACES).glob("*.json")):
        race = RaceResult.load(file)
        for row in race.agents:
            if row.driver == agent and row.errors:
                show_errors(row, f" in race {int(file.stem)} on {race.track}")
                return
