"""The state of the whole race as one vector, for centralized critics."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.engine.snapshot import KART_DTYPE, Snapshot
from stkzoo.mdp.transition import progress_of

#: The first entries of the state: time since GO [s], phase number, lap length [m], laps.
GLOBAL_FEATURES = ("time", "phase", "track_length", "laps")

_KART_FIELDS = (
    *("location", "rotation", "velocity", "angular_velocity", "speed"),
    *("energy", "skeed_factor", "shield_time", "attachment_type", "attachment_time_left"),
    *("powerup_type", "powerup_num", "node", "position", "finished_laps"),
    *("has_finished_race", "finish_time"),
)

#: The entries of each kart, agents in agent order followed by bots in grid order: fields of
#: :data:`stkzoo.engine.snapshot.KART_DTYPE` with their sizes, and the distance driven [m].
KART_FEATURES = (
    *((name, math.prod(KART_DTYPE[name].shape)) for name in _KART_FIELDS),
    ("distance", 1),
)


def state_space(num_kart: int) -> spaces.Box:
    """Returns the space of :func:`race_state`."""
    size = len(GLOBAL_FEATURES) + num_kart * sum(size for _, size in KART_FEATURES)
    return spaces.Box(-np.inf, np.inf, (size,), np.float32)


def race_state(
    snapshot: Snapshot, order: npt.NDArray[np.intp], track_length: float, laps: int
) -> npt.NDArray[np.float32]:
    """Returns the state of the race, ``(4 + 27 K,)`` float32, in the world frame.

    Args:
        snapshot: current snapshot.
        order: ``(K,)`` kart indices in the order of the state.
        track_length: length of a lap [m].
        laps: number of laps.
    """
    general = (snapshot.header["time"], snapshot.phase, track_length, laps)
    karts = snapshot.karts[order]
    columns = [karts[name].reshape(len(order), -1) for name in _KART_FIELDS]
    columns.append(progress_of(snapshot)[order, None])
    return np.concatenate([general, np.hstack(columns).ravel()]).astype(np.float32)
