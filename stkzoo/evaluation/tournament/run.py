"""Runs and resumes tournaments, reads them from their folders, and writes their reports."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stkzoo._os import make_folder
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import load_orders
from stkzoo.evaluation.batch.plan import PLAN_FILE, RESULT_FILE
from stkzoo.evaluation.batch.run import BatchKind, RaceResults, RunOptions, written
from stkzoo.evaluation.ratings import require_openskill
from stkzoo.evaluation.templates import require_jinja2
from stkzoo.evaluation.tournament.plan import TournamentPlan, plan_tournament, resumed_plan
from stkzoo.evaluation.tournament.report import TournamentReport
from stkzoo.evaluation.tournament.standings import TournamentResult, summarize_tournament

REPORT_FILE = "report.html"


def _check() -> None:
    require_openskill()
    require_jinja2()


def _write(result: TournamentResult, results: RaceResults, folder: Path) -> None:
    written(RESULT_FILE)(result, results, folder)
    if results:
        TournamentReport(folder, result, results).write(folder / REPORT_FILE)


TOURNAMENT = BatchKind(
    TournamentPlan,
    lambda plan, results, _: summarize_tournament(plan, results),
    _write,
    check=_check,
)


def run_tournament(
    agents: Sequence[str] = (), *, output: str | os.PathLike[str], **options: Any
) -> TournamentResult:
    """Runs a tournament, or resumes it if it was started in ``output``.

    When a tournament resumes with additional agents, it gets additional races for them. No race is
    repeated.

    Args:
        agents: the agents; see :func:`~stkzoo.evaluation.plan_tournament`.
        output: folder of the tournament. It stores the result of each race, ``result.json`` and
            the report.
        options: ``jobs``, ``race_timeout`` and ``on_race``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_tournament`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` contains another
            tournament.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, chosen = RunOptions.split(options)
    return TOURNAMENT.run(plan_tournament(agents, **chosen), Path(output), run)


def resume_tournament(folder: str | os.PathLike[str], **options: Any) -> TournamentResult:
    """Resumes a tournament.

    Args:
        folder: the ``output`` of :func:`run_tournament`.
        options: arguments of :class:`~stkzoo.evaluation.RunOptions`.

    Raises: as :func:`run_tournament`.
    """
    return TOURNAMENT.run(resumed_plan(folder), Path(folder), RunOptions(**options))


def load_tournament(path: str | os.PathLike[str]) -> TournamentResult:
    """Returns the current result of a tournament without running any race.

    Args:
        path: folder of the tournament, or a ``result.json``.

    Raises:
        ConfigError: there is no result, a file is damaged, or a library is missing.
    """
    return TOURNAMENT.load(path, TournamentResult)


def write_report(
    folder: str | os.PathLike[str],
    *,
    publish: str | os.PathLike[str] | None = None,
    title: str = "Tournament",
) -> Path:
    """Writes the report of a tournament, which may still be running.

    Args:
        folder: folder of the tournament.
        publish: a folder for a public report: ``index.html`` and the tables, without error
            messages, tracebacks, addresses, paths and replays. With ``None``, the full report is
            written to ``report.html`` and the tables in the tournament's folder.
        title: heading of the page.

    Returns:
        The path of the page.

    Raises:
        ConfigError: there is no tournament, no race has ended, the file of a race is damaged, a
            file cannot be written, or ``publish`` is the tournament's folder.
    """
    home = Path(folder)
    plan = TournamentPlan.load(home / PLAN_FILE)
    races = load_orders(plan.orders(), home)
    if not races:
        raise ConfigError(f"no race in {home} has ended yet; start or resume the tournament first")
    page = home / REPORT_FILE if publish is None else Path(publish, "index.html")
    if publish is not None and os.path.realpath(page.parent) == os.path.realpath(home):
        raise ConfigError(
            f"the public report would replace the tables of the tournament in {home}; choose "
            "another folder to publish"
        )
    make_folder(page.parent, "report")
    result = summarize_tournament(plan, races)
    TournamentReport(home, result, races, publish is not None, title).write(page)
    return page
