"""Runs batches of races for commands, with a progress bar and error messages."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

from stkzoo._arguments import option
from stkzoo._locks import LOCK
from stkzoo.cli._console import QuietLines, make_bars, say
from stkzoo.cli._process import AGENT_FAILED, INTERRUPTED
from stkzoo.cli._race_report import show_errors
from stkzoo.evaluation import BatchError, BatchProgress, RunOptions
from stkzoo.evaluation.batch.order import RACES
from stkzoo.evaluation.batch.plan import PLAN_FILE
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

#: Leading dots, and characters that separate folders or are invalid in names on some systems.
_UNSAFE = re.compile(r"^\.+|[/\\<>\"|?*]")
#: Values of ``reverse`` by the names of ``--directions``.
_DIRECTIONS = {"forward": False, "reversed": True}

Result = TypeVar("Result")
AnyDocument = TypeVar("AnyDocument", bound=Document)


@dataclass
class BatchArguments:
    """Options of all commands that run many races.

    Attributes:
        jobs: races at the same time (default: all CPU cores)
        race_timeout: time limit of one race; a longer race is repeated with a time budget for
            each agent
    """

    jobs: int | None = None
    race_timeout: float = option(3600.0, metavar="SECONDS")


def tracks_option() -> Any:
    """Returns a field for ``--track`` that takes several names."""
    return option(
        ("train",),
        flag="--track",
        metavar="TRACK",
        help="names of tracks, or train, train_only, validation, test or all",
    )


def directions_option(*default: str) -> Any:
    """Returns a field for ``--directions``.

    Args:
        *default: names of the default directions.
    """
    return option(default, choices=list(_DIRECTIONS), help="directions to drive the tracks")


def reverse_of(directions: tuple[str, ...]) -> list[bool]:
    """Returns the value of ``reverse`` for each of ``--directions``."""
    return [_DIRECTIONS[name] for name in directions]


def run_batch(
    batch: BatchArguments,
    run: Callable[[RunOptions], Result],
    *,
    has_plots: bool = True,
    is_saved: bool = True,
) -> tuple[Result | None, int]:
    """Runs a batch with a progress bar, or lines of progress if there is no terminal.

    Args:
        batch: options of the batch.
        run: function that runs the batch.
        has_plots: whether to draw the result.
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
            return run(RunOptions(batch.jobs, batch.race_timeout, update, has_plots)), 0
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            return error.result, 1
        except KeyboardInterrupt:
            saved = f"{done} of {total} races are saved; run the same command to resume"
            text = saved if is_saved and total else "nothing was saved"
            print(f"stkzoo: interrupted; {text}", file=sys.stderr)
            return None, INTERRUPTED


def run_replays(batch: BatchArguments, run: Callable[..., Result]) -> tuple[Result | None, int]:
    """Runs recorded races again with a progress bar.

    Args:
        batch: options of the batch.
        run: function that runs the races, with arguments ``jobs``, ``race_timeout``, ``on_race``.

    Returns:
        See :func:`run_batch`.
    """

    def rerun(options: RunOptions) -> Result:
        return run(jobs=options.jobs, race_timeout=options.race_timeout, on_race=options.on_race)

    return run_batch(batch, rerun, is_saved=False)


def file_name(label: str) -> str:
    """Converts the label of an agent, which its code may choose, to the name of a file or folder.

    Args:
        label: the label.

    Returns:
        A name without path separators that is not ``.`` or ``..``.
    """
    return _UNSAFE.sub("_", label).replace(":", "-")


def run_and_show(
    arguments: Any,
    run: Callable[[Any, Path, RunOptions], AnyDocument],
    plan: Any,
    folder: Path,
    show: Callable[[AnyDocument], object],
) -> int:
    """Runs a batch and shows its result.

    Args:
        arguments: arguments of the command, with ``batch``, ``json`` and possibly ``no_plot``.
        run: function that runs the batch.
        plan: plan of the batch. If it has one ``agent``, the agent's first failure is shown.
        folder: folder of the batch.
        show: function that prints the result.

    Returns:
        The exit code.
    """
    has_plots = not getattr(arguments, "no_plot", False)
    result, code = run_batch(arguments.batch, partial(run, plan, folder), has_plots=has_plots)
    if result is None:
        return code
    has_failed = bool(getattr(result, "errors", 0))
    if arguments.json:
        print(result.to_json())
    else:
        show(result)
        if has_failed and hasattr(plan, "agent"):
            _show_first_failure(folder, plan.agent.label)
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
