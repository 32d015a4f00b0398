"""Races between drivers.

>>> from stkzoo.race import run_race
>>> result = run_race(["heuristic", "ai"], track="lighthouse", seed=1)
>>> [agent.rank for agent in result.agents]
[1, 2]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stkzoo._imports import lazy_names
from stkzoo.drivers import (
    Actor,
    ActorMaker,
    Decision,
    Driver,
    DriverInstance,
    DriverLimits,
    DriverRequest,
    driver_names,
    find_driver,
)
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import (
    SCHEMA_VERSION,
    ActionTime,
    AgentFailure,
    AgentResult,
    RaceResult,
)
from stkzoo.race.settings import ERROR_HANDLING, RaceSettings

if TYPE_CHECKING:
    from stkzoo.race.runner import RaceInterrupted, run_race
    from stkzoo.race.video import RaceVideo

__all__ = [
    "ERROR_HANDLING",
    "SCHEMA_VERSION",
    "ActionTime",
    "Actor",
    "ActorMaker",
    "AgentFailure",
    "AgentResult",
    "Decision",
    "Driver",
    "DriverInstance",
    "DriverLimits",
    "DriverRequest",
    "RaceInterrupted",
    "RaceListener",
    "RaceProgress",
    "RaceResult",
    "RaceSettings",
    "RaceVideo",
    "driver_names",
    "find_driver",
    "run_race",
]
__dir__ = __all__.copy

# Imported on first use, because they load the environment and the renderer.
_HOMES = {
    "stkzoo.race.runner": ("RaceInterrupted", "run_race"),
    "stkzoo.race.video": ("RaceVideo",),
}
__getattr__ = lazy_names(__name__, _HOMES)
