"""The whole race as one vector, for critics that may see everything."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.engine.snapshot import Snapshot
from stkzoo.mdp.transition import progress_of

#: What the state tells first: seconds since GO, phase number, lap length [m], laps.
GLOBAL_FEATURES = ("time", "phase", "track_length", "laps")

_KART_FIELDS = (
    ("location", 3),
    ("rotation", 4),
    ("velocity", 3),
    ("angular_velocity", 3),
    ("speed", 1),
    ("energy", 1),
    ("skeed_factor", 1),
    ("shield_time", 1),
    ("attachment_type", 1),
    ("attachment_time_left", 1),
    ("powerup_type", 1),
    ("powerup_num", 1),
    ("node", 1),
    ("position", 1),
    ("finished_laps", 1),
    ("has_finished_race", 1),
    ("finish_time", 1),
)

#: What it tells of each kart, in agent order and then bots in grid order: fields of
#: :data:`stkzoo.engine.snapshot.KART_DTYPE` with their sizes, and the metres driven.
KART_FEATURES = (*_KART_FIELDS, ("distance", 1))


def state_space(num_kart: int) -> spaces.Box:
    """The space of :func:`race_state`."""
    size = len(GLOBAL_FEATURES) + num_kart * sum(size for _, size in KART_FEATURES)
    return spaces.Box(-np.inf, np.inf, (size,), np.float32)


def race_state(
    snapshot: Snapshot, order: npt.NDArray[np.intp], track_length: float, laps: int
) -> npt.NDArray[np.float32]:
    """The race as ``(4 + 27 K,)`` float32, world frame.

    Args:
        snapshot: the moment.
        order: ``(K,)`` kart indices in the order in which the state tells of them.
        track_length: length of a lap [m].
        laps: number of laps.
    """
    general = (snapshot.header["time"], snapshot.phase, track_length, laps)
    karts = snapshot.karts[order]
    columns = [karts[name].reshape(len(order), size) for name, size in _KART_FIELDS]
    columns.append(progress_of(snapshot)[order, None])
    return np.concatenate([general, np.hstack(columns).ravel()]).astype(np.float32)
