"""Tournaments: many races among many agents, and what they say about who is better.

>>> from stkzoo.evaluation.tournament import run_tournament
>>> result = run_tournament(
...     ["heuristic", "ai", "random"],
...     tracks=["lighthouse"], races=3, per_race=3, max_steps=100, output="/tmp/cup",
... )  # doctest: +SKIP
>>> result.standings[0].label  # doctest: +SKIP
'ai'
"""

from __future__ import annotations

from stkzoo.evaluation.tournament.plan import Entrant, TournamentPlan, plan_tournament
from stkzoo.evaluation.tournament.plot import plot_tournament
from stkzoo.evaluation.tournament.result import Standing, TournamentResult, tournament_result
from stkzoo.evaluation.tournament.run import (
    TournamentError,
    TournamentProgress,
    load_tournament,
    resume_tournament,
    run_tournament,
)
from stkzoo.evaluation.tournament.schedule import ScheduledRace, make_schedule

__all__ = [
    "Entrant",
    "ScheduledRace",
    "Standing",
    "TournamentError",
    "TournamentPlan",
    "TournamentProgress",
    "TournamentResult",
    "load_tournament",
    "make_schedule",
    "plan_tournament",
    "plot_tournament",
    "resume_tournament",
    "run_tournament",
    "tournament_result",
]
