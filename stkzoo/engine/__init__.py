"""The game: its data, its processes, and its state as arrays.

Only this package imports ``pystk2``, and only in processes that run or draw a race:
:mod:`~stkzoo.engine.race` and :mod:`~stkzoo.engine.render_process` do. It needs numpy, the
kernel and the modules directly in ``stkzoo``, so that an engine process starts quickly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stkzoo._lazy import lazy_names

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

# An engine process needs few of them.
_HOMES = {
    "stkzoo.engine.session": ("WorkerSession",),
    "stkzoo.engine.setup": ("KartSetup", "RaceSetup"),
    "stkzoo.engine.snapshot": ("Snapshot",),
    "stkzoo.engine.track": ("TrackMap", "decode_track"),
}
__getattr__ = lazy_names(__name__, _HOMES)
