"""The game: its data, its processes, and its state as arrays.

Only this package imports ``pystk2``, and only in processes that run or draw a race:
:mod:`~stkzoo.engine.race` and :mod:`~stkzoo.engine.render_process` do. It needs numpy, the
kernel and the modules directly in ``stkzoo``, so that an engine process starts quickly.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.engine.session import WorkerSession
    from stkzoo.engine.setup import KartSetup, RaceSetup
    from stkzoo.engine.snapshot import Snapshot
    from stkzoo.engine.track import TrackMap, decode_track

__all__ = [
    "KartSetup",
    "RaceSetup",
    "Snapshot",
    "TrackMap",
    "WorkerSession",
    "decode_track",
]

#: Modules of the names, loaded when they are first used: an engine process needs few.
_HOMES = {
    "KartSetup": "setup",
    "RaceSetup": "setup",
    "Snapshot": "snapshot",
    "TrackMap": "track",
    "WorkerSession": "session",
    "decode_track": "track",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
