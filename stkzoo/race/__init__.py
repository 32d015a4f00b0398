"""Runs races of drivers.

>>> from stkzoo.race import run_race
>>> result = run_race(["heuristic", "ai"], track="lighthouse", seed=1)
>>> [agent.rank for agent in result.agents]
[1, 2]
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.race.agents.code import Actor, ActorMaker
    from stkzoo.race.drivers import Driver, driver_names, find_driver
    from stkzoo.race.instances import Decision, DriverInstance, DriverLimits, DriverRequest
    from stkzoo.race.listeners import RaceListener, RaceProgress
    from stkzoo.race.result import (
        SCHEMA_VERSION,
        ActionTime,
        AgentFailure,
        AgentResult,
        RaceResult,
    )
    from stkzoo.race.runner import RaceInterrupted, run_race
    from stkzoo.race.settings import ERROR_HANDLING, RaceSettings
    from stkzoo.race.video import RaceFilm, RaceVideo

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
    "RaceFilm",
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

#: Names by module, loaded when they are first used: the process of an agent needs few.
_LAZY = {
    "agents.code": ("Actor", "ActorMaker"),
    "drivers": ("Driver", "driver_names", "find_driver"),
    "instances": ("Decision", "DriverInstance", "DriverLimits", "DriverRequest"),
    "listeners": ("RaceListener", "RaceProgress"),
    "result": ("SCHEMA_VERSION", "ActionTime", "AgentFailure", "AgentResult", "RaceResult"),
    "runner": ("RaceInterrupted", "run_race"),
    "settings": ("ERROR_HANDLING", "RaceSettings"),
    "video": ("RaceFilm", "RaceVideo"),
}
_HOMES = {name: module for module, names in _LAZY.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
