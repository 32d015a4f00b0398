"""Runs a tournament, or goes on with one."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from stkzoo.errors import StkzooError
from stkzoo.evaluation.batch import (
    RACE_TIMEOUT,
    BatchFolder,
    BatchProgress,
    BatchRunner,
    ProgressListener,
    errors_in_words,
    read_races,
    write_whole,
)
from stkzoo.evaluation.plotting import require_matplotlib
from stkzoo.evaluation.ratings import require_openskill
from stkzoo.evaluation.tournament.plan import TOURNAMENT, TournamentPlan, plan_tournament
from stkzoo.evaluation.tournament.plot import plot_tournament
from stkzoo.evaluation.tournament.result import TournamentResult, tournament_result

__all__ = [
    "TournamentError",
    "TournamentProgress",
    "load_tournament",
    "resume_tournament",
    "run_tournament",
]

_RESULT, _PLOT = "result.json", "tournament.png"

#: How far a tournament has come.
TournamentProgress = BatchProgress


class TournamentError(StkzooError):
    """Some races could not be run; the others have been, and are kept.

    Attributes:
        result: what the others came to.
    """

    def __init__(self, message: str, result: TournamentResult) -> None:
        super().__init__(message)
        self.result = result


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
    """Runs a tournament, or goes on with it if it has been begun in ``output``.

    Args:
        agents: who takes part; see
            :func:`~stkzoo.evaluation.tournament.plan.plan_tournament`.
        output: a folder of its own: every race's result as soon as it is over, and in the
            end ``result.json`` and ``tournament.png``.
        jobs: how many races at a time; by default as many as there are processors.
        plot: draw ``tournament.png``.
        race_timeout: for one race [s].
        on_race: is told of every race.
        plan: ``tracks``, ``races``, ``per_race``, ``seed``, ``settings`` and fields of
            :class:`~stkzoo.race.RaceSettings`, as for ``plan_tournament``.

    Raises:
        ConfigError: an argument cannot be, a library is missing, or ``output`` has another
            tournament.
        AssetError: the game's data is missing.
        TournamentError: some races could not be run.
    """
    whole = plan_tournament(agents, **plan)
    return _run(whole, output, BatchRunner(jobs, race_timeout, on_race), plot)


def resume_tournament(
    folder: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
) -> TournamentResult:
    """Goes on with the tournament that was begun in a folder.

    Args:
        folder: the ``output`` of :func:`run_tournament`.
        jobs: as there, like the others.
        plot: likewise.
        race_timeout: likewise.
        on_race: likewise.

    Raises: as :func:`run_tournament`.
    """
    plan = TOURNAMENT.read_plan(Path(folder)).as_of_now()
    return _run(plan, folder, BatchRunner(jobs, race_timeout, on_race), plot)


def load_tournament(folder: str | os.PathLike[str]) -> TournamentResult:
    """What the tournament in a folder has come to so far; runs nothing.

    Raises:
        ConfigError: there is none, it is damaged, or a library is missing.
    """
    plan = TOURNAMENT.read_plan(Path(folder))
    return tournament_result(plan, read_races(Path(folder), plan.orders()))


def _run(
    plan: TournamentPlan, folder: str | os.PathLike[str], runner: BatchRunner, plot: bool
) -> TournamentResult:
    require_openskill()
    if plot:
        require_matplotlib("tournament", "leave the plot out (--no-plot)")
    with BatchFolder(TOURNAMENT, folder) as place:
        plan = place.keep_plan(plan)
        results, errors = runner.run(place, plan.orders())
        result = tournament_result(plan, results)
        write_whole(place.path / _RESULT, result.to_json() + "\n")
        if plot and results:
            plot_tournament(result, place.path / _PLOT)
    if errors:
        raise TournamentError(errors_in_words(errors, plan.races), result)
    return result
