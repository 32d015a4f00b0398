"""The interface to the game: its data, its processes, and its state as arrays.

Only this package imports ``pystk2``: :mod:`~stkzoo.engine.race` and
:mod:`~stkzoo.engine.render_process` import it when they run or draw a race. To start quickly, an
engine process imports only numpy, the kernel and modules directly in ``stkzoo`` besides this
package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from stkzoo._imports import lazy_names

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

# Names are imported on first use, because an engine process needs only a few of them.
_HOMES = {
    "stkzoo.engine.session": ("WorkerSession",),
    "stkzoo.engine.setup": ("KartSetup", "RaceSetup"),
    "stkzoo.engine.snapshot": ("Snapshot",),
    "stkzoo.engine.track": ("TrackMap", "decode_track"),
}
__getattr__ = lazy_names(__name__, _HOMES)
