"""Runs a tournament, or goes on with one."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stkzoo.errors import ConfigError, StkzooError
from stkzoo.race.result import RaceResult
from stkzoo.race.tournament.journal import Journal, read_plan, read_races, write_whole
from stkzoo.race.tournament.plan import TournamentPlan, plan_tournament
from stkzoo.race.tournament.plot import plot_library, save_plot
from stkzoo.race.tournament.pool import run_in_parallel
from stkzoo.race.tournament.ratings import rating_library
from stkzoo.race.tournament.result import TournamentResult, tournament_result

__all__ = [
    "TournamentError",
    "TournamentProgress",
    "load_tournament",
    "resume_tournament",
    "run_tournament",
]

_RESULT, _PLOT = "result.json", "tournament.png"
_RACE_TIMEOUT = 3600.0  # [s]
_MAX_TOLD = 3


class TournamentError(StkzooError):
    """Some races could not be run; the others have been, and are kept.

    Attributes:
        result: what the others came to.
    """

    def __init__(self, message: str, result: TournamentResult) -> None:
        super().__init__(message)
        self.result = result


@dataclass(frozen=True, slots=True)
class TournamentProgress:
    """How far a tournament has come.

    Attributes:
        done: races that have been run.
        total: races in all.
        last: the race that has just been run; ``None`` at the beginning, and for one that
            could not be run.
        error: why it could not be run.
    """

    done: int
    total: int
    last: RaceResult | None = None
    error: str = ""


ProgressListener = Callable[[TournamentProgress], None]


def run_tournament(
    agents: Sequence[str],
    *,
    output: str | os.PathLike[str],
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = _RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
    **plan: Any,
) -> TournamentResult:
    """Runs a tournament, or goes on with it if it has been begun in ``output``.

    Args:
        agents: who takes part; see
            :func:`~stkzoo.race.tournament.plan.plan_tournament`.
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
    return _Tournament(whole, jobs, plot, race_timeout, on_race).run_in(output)


def resume_tournament(
    folder: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    plot: bool = True,
    race_timeout: float = _RACE_TIMEOUT,
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
    plan = read_plan(Path(folder)).as_of_now()
    return _Tournament(plan, jobs, plot, race_timeout, on_race).run_in(folder)


def load_tournament(folder: str | os.PathLike[str]) -> TournamentResult:
    """What the tournament in a folder has come to so far; runs nothing.

    Raises:
        ConfigError: there is none, it is damaged, or a library is missing.
    """
    plan = read_plan(Path(folder))
    return tournament_result(plan, read_races(Path(folder), plan))


class _Tournament:
    """A tournament to be run."""

    def __init__(
        self,
        plan: TournamentPlan,
        jobs: int | None,
        plot: bool,
        race_timeout: float,
        on_race: ProgressListener | None,
    ) -> None:
        if jobs is not None and (not isinstance(jobs, int) or isinstance(jobs, bool) or jobs < 1):
            raise ConfigError(f"jobs is {jobs!r}, expected a whole number of 1 or more")
        if not 0 < race_timeout < 1e9:
            raise ConfigError(f"race_timeout is {race_timeout!r}, expected seconds above 0")
        rating_library()
        if plot:
            plot_library()
        self._plan, self._jobs = plan, jobs or _processors()
        self._plot, self._race_timeout, self._on_race = plot, race_timeout, on_race

    def run_in(self, folder: str | os.PathLike[str]) -> TournamentResult:
        with Journal(folder) as journal:
            self._plan = journal.keep_plan(self._plan)
            results = journal.done(self._plan)
            errors = self._run(journal, results)
            result = tournament_result(self._plan, results)
            write_whole(journal.folder / _RESULT, result.to_json() + "\n")
            if self._plot and results:
                save_plot(result, journal.folder / _PLOT)
        if errors:
            raise TournamentError(_told(errors, self._plan.races), result)
        return result

    def _run(self, journal: Journal, results: dict[int, RaceResult]) -> dict[int, str]:
        """Runs what is left; those races that could not be run, and why."""
        left = [race for race in self._plan.schedule() if race.number not in results]
        errors: dict[int, str] = {}
        self._tell(TournamentProgress(len(results), self._plan.races))
        running = run_in_parallel(self._plan, left, self._jobs, self._race_timeout)
        with closing(running) as outcomes:  # which ends the races that run, also after an error
            for outcome in outcomes:
                last = None
                if outcome.error:
                    errors[outcome.race.number] = outcome.error
                else:
                    journal.add(outcome.race, outcome.result)
                    last = results[outcome.race.number] = RaceResult.from_json(outcome.result)
                self._tell(TournamentProgress(len(results), self._plan.races, last, outcome.error))
        return errors

    def _tell(self, progress: TournamentProgress) -> None:
        if self._on_race is not None:
            self._on_race(progress)


def _told(errors: dict[int, str], total: int) -> str:
    first = list(errors.items())[:_MAX_TOLD]
    lines = "".join(f"\nrace {number}: {error}" for number, error in first)
    more = f"\n... and {len(errors) - len(first)} more" if len(errors) > len(first) else ""
    return (
        f"{len(errors)} of {total} races could not be run; the others are kept, and the same "
        f"command tries these again:{lines}{more}"
    )


def _processors() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1
