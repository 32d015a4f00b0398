"""Many races, some at a time, kept in a folder and gone on with after an interruption.

Tournaments and benchmarks are made of this.
"""

from __future__ import annotations

from stkzoo.race.batch.entrant import Entrant, find_entrants
from stkzoo.race.batch.folder import BatchFolder, BatchKind, BatchPlan, read_races, write_whole
from stkzoo.race.batch.order import RaceOrder
from stkzoo.race.batch.run import (
    RACE_TIMEOUT,
    BatchProgress,
    BatchRunner,
    ProgressListener,
    errors_in_words,
)

__all__ = [
    "RACE_TIMEOUT",
    "BatchFolder",
    "BatchKind",
    "BatchPlan",
    "BatchProgress",
    "BatchRunner",
    "Entrant",
    "ProgressListener",
    "RaceOrder",
    "errors_in_words",
    "find_entrants",
    "read_races",
    "write_whole",
]
