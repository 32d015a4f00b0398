"""Runs and resumes tournaments, and reads them from their folders."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from stkzoo._os import using_folder
from stkzoo.evaluation.batch.entrants import find_entrants, is_entered
from stkzoo.evaluation.batch.order import load_orders
from stkzoo.evaluation.batch.plan import PLAN_FILE
from stkzoo.evaluation.batch.run import RunOptions, load_batch, run_batch
from stkzoo.evaluation.tournament.plan import (
    TournamentPlan,
    TournamentResult,
    ask_servers,
    plan_tournament,
)
from stkzoo.race.remote import ServerAccess
from stkzoo.race.result import RaceResult, versions_now


def run_tournament(
    agents: Sequence[str] = (), *, output: str | os.PathLike[str], **options: Any
) -> TournamentResult:
    """Runs a tournament, or resumes it if it was started in ``output``.

    When a tournament resumes with additional agents, it gets additional races for them. No race is
    repeated.

    Args:
        agents: the agents; see :func:`~stkzoo.evaluation.plan_tournament`.
        output: folder of the tournament. It stores the result of each race, ``result.json``,
            ``tournament.png`` and the report.
        options: ``jobs``, ``race_timeout``, ``on_race`` and ``plot``, as in
            :class:`~stkzoo.evaluation.RunOptions`; all others as for
            :func:`~stkzoo.evaluation.plan_tournament`.

    Raises:
        ConfigError: an argument is invalid, a library is missing, or ``output`` contains another
            tournament.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, chosen = RunOptions.split(options)
    plan = plan_tournament(agents, **chosen)
    if chosen.get("per_race") is None:
        plan = with_stored_per_race(plan, output)
    return run_batch(plan, output, run)


def with_stored_per_race(plan: TournamentPlan, folder: str | os.PathLike[str]) -> TournamentPlan:
    """Returns a plan with as many agents per race as the tournament in a folder, if there is one.

    The default of a new tournament depends on the number of its agents, which may since have grown.

    Args:
        plan: the plan.
        folder: folder of the tournament.

    Raises:
        ConfigError: the folder or its plan cannot be read.
    """
    file = Path(folder) / PLAN_FILE
    with using_folder(Path(folder), plan.noun):
        is_new = not file.exists()
    if is_new:
        return plan
    stored = TournamentPlan.load(file).per_race
    return replace(plan, per_race=min(stored, len(plan.entrants)))


def resume_tournament(folder: str | os.PathLike[str], **options: Any) -> TournamentResult:
    """Resumes a tournament.

    Args:
        folder: the ``output`` of :func:`run_tournament`.
        options: arguments of :class:`~stkzoo.evaluation.RunOptions`.

    Raises: as :func:`run_tournament`.
    """
    return run_batch(resumed_plan(folder), folder, RunOptions(**options))


def resumed_plan(
    folder: str | os.PathLike[str],
    agents: Sequence[str] = (),
    servers: ServerAccess | None = None,
) -> TournamentPlan:
    """Returns the plan of a tournament with the current versions of software and agents' files.

    Args:
        folder: folder of the tournament.
        agents: agents that join the tournament, unless they have already joined it.
        servers: servers whose agents join the tournament, unless they have already joined it.

    Raises:
        ConfigError: there is no plan, or an agent is invalid.
        RemoteError: a server does not answer.
    """
    plan = TournamentPlan.load(Path(folder) / PLAN_FILE).moved(Path(folder))
    entrants = tuple(entry.now() for entry in plan.entrants)
    served, access = ask_servers(servers)
    known = {entry.served for entry in entrants}
    joining = [agent for agent in served if agent not in known]
    labels = [entry.label for entry in entrants]
    others = [text for text in agents if not is_entered(text, entrants)]
    new = find_entrants(others, plan.settings, joining, labels)
    return replace(
        plan, entrants=(*entrants, *new), access=access or plan.access, versions=versions_now()
    )


def load_races(folder: Path) -> tuple[TournamentResult, dict[int, RaceResult]]:
    """Returns the current result of a tournament, and the results of its races by number.

    Args:
        folder: folder of the tournament.

    Raises:
        ConfigError: there is no tournament, or the file of a race is damaged.
    """
    plan = TournamentPlan.load(folder / PLAN_FILE)
    races = load_orders(plan.orders(), folder)
    return plan.summarize(races, folder), races


def load_tournament(path: str | os.PathLike[str]) -> TournamentResult:
    """Returns the current result of a tournament without running any race.

    Args:
        path: folder of the tournament, or a ``result.json``.

    Raises:
        ConfigError: there is no result, a file is damaged, or a library is missing.
    """
    return load_batch(TournamentPlan, TournamentResult, path)
