"""Runs batches of races for commands, with a progress bar and error messages."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from stkzoo._arguments import option
from stkzoo._locks import LOCK
from stkzoo.cli._console import Bars, say, show
from stkzoo.cli._process import AGENT_FAILED, INTERRUPTED
from stkzoo.cli._race_report import show_errors
from stkzoo.evaluation import BatchError, BatchProgress, RunOptions
from stkzoo.evaluation.batch.order import RACES
from stkzoo.evaluation.batch.plan import PLAN_FILE
from stkzoo.evaluation.batch.run import BatchKind
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult

#: Leading dots, and characters that separate folders or are invalid in names on some systems.
_UNSAFE = re.compile(r"^\.+|[/\\<>\"|?*]")
#: Fields of ``RunOptions`` that are options of commands.
RUN_OPTIONS = ("jobs", "race_timeout")
_DIRECTIONS = ("forward", "reversed")

Result = TypeVar("Result")
AnyDocument = TypeVar("AnyDocument", bound=Document)


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
    return option(default, choices=_DIRECTIONS, help="directions to drive the tracks")


def reverse_of(directions: tuple[str, ...]) -> list[bool]:
    """Returns the value of ``reverse`` for each of ``--directions``."""
    return [name == "reversed" for name in directions]


def run_batch(
    options: Mapping[str, Any], run: Callable[..., Result], *, is_saved: bool = True
) -> tuple[Result | None, int]:
    """Runs a batch with a progress bar, or lines of progress if there is no terminal.

    Args:
        options: values of :data:`RUN_OPTIONS`.
        run: function that runs the batch. Its keyword arguments are fields of
            :class:`~stkzoo.evaluation.RunOptions`.
        is_saved: whether the batch saves each race, so that the same command resumes it.

    Returns:
        The result and the exit code. The result is ``None`` if there is no result to show.
    """
    with Bars() as bars:
        bars.begin("races")
        (task,) = bars.tasks

        def update(progress: BatchProgress) -> None:
            text, last = f"{progress.done} of {progress.total}", progress.last
            if progress.failed:
                text += f", {progress.failed} failed"
            if last:
                text += f", {last.agents[0].driver} won on {last.track}"
            bars.show(progress.done, text, progress.total)

        try:
            return run(**options, on_race=update), 0
        except BatchError as error:
            print(f"stkzoo: {error}", file=sys.stderr)
            return error.result, 1
        except KeyboardInterrupt:
            text = "nothing was saved"
            if is_saved and task.total:
                saved = f"{task.completed} of {task.total} races are saved"
                text = f"{saved}; run the same command to resume"
            print(f"stkzoo: interrupted; {text}", file=sys.stderr)
            return None, INTERRUPTED


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
    batch_kind: BatchKind[Any, AnyDocument],
    plan: Any,
    folder: Path,
    as_text: Callable[[AnyDocument], object],
) -> int:
    """Runs a batch and shows its result.

    Args:
        arguments: arguments of the command, with ``batch``, ``json`` and possibly ``no_plot``.
        batch_kind: kind of the batch.
        plan: plan of the batch. If it has one ``agent``, the agent's first failure is shown.
        folder: folder of the batch.
        as_text: function that prints the result.

    Returns:
        The exit code.
    """

    def run(**options: Any) -> AnyDocument:
        plot = not getattr(arguments, "no_plot", False)
        return batch_kind.run(plan, folder, RunOptions(**options, plot=plot))

    result, code = run_batch(arguments.batch, run)
    if result is None:
        return code
    has_failed = bool(getattr(result, "errors", 0))
    show(result, as_text, as_json=arguments.json)
    if not arguments.json:
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
