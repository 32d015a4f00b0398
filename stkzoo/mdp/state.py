"""The whole race as one vector, for critics that may see everything."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.engine.snapshot import KART_DTYPE, Snapshot
from stkzoo.mdp.transition import progress_of

#: What the state tells first: seconds since GO, phase number, lap length [m], laps.
GLOBAL_FEATURES = ("time", "phase", "track_length", "laps")

_KART_FIELDS = (
    *("location", "rotation", "velocity", "angular_velocity", "speed"),
    *("energy", "skeed_factor", "shield_time", "attachment_type", "attachment_time_left"),
    *("powerup_type", "powerup_num", "node", "position", "finished_laps"),
    *("has_finished_race", "finish_time"),
)

#: What it tells of each kart, in agent order and then bots in grid order: fields of
#: :data:`stkzoo.engine.snapshot.KART_DTYPE` with their sizes, and the metres driven.
KART_FEATURES = (
    *((name, math.prod(KART_DTYPE[name].shape)) for name in _KART_FIELDS),
    ("distance", 1),
)


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
    columns = [karts[name].reshape(len(order), -1) for name in _KART_FIELDS]
    columns.append(progress_of(snapshot)[order, None])
    return np.concatenate([general, np.hstack(columns).ravel()]).astype(np.float32)
