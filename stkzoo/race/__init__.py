"""Running a race of drivers from start to finish.

>>> from stkzoo.race import run_race
>>> result = run_race(["heuristic", "ai"], track="lighthouse", seed=1)
>>> [agent.rank for agent in result.agents]
[1, 2]
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.race.drivers import Driver, driver_names, find_driver
    from stkzoo.race.instances import Decision, DriverInstance, DriverLimits, DriverRequest
    from stkzoo.race.listeners import RaceListener, RaceProgress
    from stkzoo.race.result import ActionTime, AgentFailure, AgentResult, RaceResult
    from stkzoo.race.runner import RaceInterrupted, run_race
    from stkzoo.race.settings import ERROR_HANDLING, RaceSettings

__all__ = [
    "ERROR_HANDLING",
    "ActionTime",
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
    "driver_names",
    "find_driver",
    "run_race",
]

#: Names by module, loaded when they are first used: the process of an agent needs few.
_LAZY = {
    "drivers": ("Driver", "driver_names", "find_driver"),
    "instances": ("Decision", "DriverInstance", "DriverLimits", "DriverRequest"),
    "listeners": ("RaceListener", "RaceProgress"),
    "result": ("ActionTime", "AgentFailure", "AgentResult", "RaceResult"),
    "runner": ("RaceInterrupted", "run_race"),
    "settings": ("ERROR_HANDLING", "RaceSettings"),
}
_HOMES = {name: module for module, names in _LAZY.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
