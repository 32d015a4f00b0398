"""Runs a tournament, or resumes one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stkzoo.evaluation.batch.order import load_orders
from stkzoo.evaluation.batch.plan import read_plan
from stkzoo.evaluation.batch.run import (
    RACE_TIMEOUT,
    ProgressListener,
    RunOptions,
    run_batch,
)
from stkzoo.evaluation.ratings import require_openskill
from stkzoo.evaluation.tournament.plan import TournamentPlan, plan_tournament
from stkzoo.evaluation.tournament.plot import plot_tournament
from stkzoo.evaluation.tournament.result import TournamentResult, tournament_result


def run_tournament(
    agents: Sequence[str],
    *,
    output: str | os.PathLike[str],
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
    **plan: Any,
) -> TournamentResult:
    """Runs a tournament, or resumes it if it was started in ``output``.

    Args:
        agents: the agents; see :func:`~stkzoo.evaluation.plan_tournament`.
        output: a folder of its own, for every race's result and finally ``result.json`` and
            ``tournament.png``.
        jobs: see :class:`~stkzoo.evaluation.RunOptions`.
        plot: draw ``tournament.png``.
        race_timeout: see :class:`~stkzoo.evaluation.RunOptions`.
        on_race: likewise.
        plan: ``tracks``, ``races``, ``per_race``, ``seed``, ``settings`` and fields of
            :class:`~stkzoo.race.RaceSettings`, as for
            :func:`~stkzoo.evaluation.plan_tournament`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` has another
            tournament.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    options = RunOptions(jobs, race_timeout, on_race)
    return run_tournament_plan(plan_tournament(agents, **plan), output, options, plot=plot)


def resume_tournament(
    folder: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
) -> TournamentResult:
    """Resumes the tournament that was started in a folder.

    Args:
        folder: the ``output`` of :func:`run_tournament`.
        jobs: as for :func:`run_tournament`.
        plot: likewise.
        race_timeout: likewise.
        on_race: likewise.

    Raises: as :func:`run_tournament`.
    """
    options = RunOptions(jobs, race_timeout, on_race)
    return run_tournament_plan(resumed_plan(folder), folder, options, plot=plot)


def resumed_plan(folder: str | os.PathLike[str]) -> TournamentPlan:
    """The plan of the tournament in a folder, with the present software and agents' files."""
    return read_plan(TournamentPlan, Path(folder)).as_of_now()


def run_tournament_plan(
    plan: TournamentPlan, output: str | os.PathLike[str], options: RunOptions, *, plot: bool = True
) -> TournamentResult:
    """Runs a planned tournament, or resumes it; see :func:`run_tournament`."""
    require_openskill()
    return run_batch(plan, output, options, tournament_result, plot_tournament if plot else None)


def load_tournament(folder: str | os.PathLike[str]) -> TournamentResult:
    """The result of the tournament in a folder so far, without running anything.

    Raises:
        ConfigError: there is none, it is damaged, or a library is missing.
    """
    plan = read_plan(TournamentPlan, Path(folder))
    return tournament_result(plan, load_orders(plan.orders(), Path(folder)))
