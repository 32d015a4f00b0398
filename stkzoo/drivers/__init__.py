"""Drivers of karts: the game's AI, stkzoo's drivers, agents from files and Python functions."""

from __future__ import annotations

from stkzoo.drivers.code import Actor, ActorMaker
from stkzoo.drivers.driver import Driver, driver_names, find_driver
from stkzoo.drivers.instances import Decision, DriverInstance, DriverLimits, DriverRequest
from stkzoo.drivers.pool import OpponentPool

__all__ = [
    "Actor",
    "ActorMaker",
    "Decision",
    "Driver",
    "DriverInstance",
    "DriverLimits",
    "DriverRequest",
    "OpponentPool",
    "driver_names",
    "find_driver",
]
__dir__ = __all__.copy
