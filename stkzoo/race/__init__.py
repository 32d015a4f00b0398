"""Running a race of drivers from start to finish.

>>> from stkzoo.race import run_race
>>> result = run_race(["heuristic", "ai"], track="lighthouse", seed=1)
>>> [agent.rank for agent in result.agents]
[1, 2]
"""

from __future__ import annotations

from stkzoo.race.drivers import Driver, find_driver
from stkzoo.race.result import AgentResult, RaceResult
from stkzoo.race.runner import RaceListener, RaceProgress, run_race

__all__ = [
    "AgentResult",
    "Driver",
    "RaceListener",
    "RaceProgress",
    "RaceResult",
    "find_driver",
    "run_race",
]
