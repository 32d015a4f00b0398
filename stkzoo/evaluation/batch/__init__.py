"""Many races, some at a time, kept in a folder and gone on with after an interruption.

Tournaments and benchmarks are made of this.
"""

from __future__ import annotations

from stkzoo.evaluation.batch.entrant import Entrant, find_entrants
from stkzoo.evaluation.batch.folder import (
    BatchFolder,
    BatchKind,
    BatchPlan,
    read_races,
    write_whole,
)
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.run import (
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
