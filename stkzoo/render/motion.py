"""Interpolation of karts between two steps."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot

FloatArray = npt.NDArray[np.float32]

#: A kart that moved this much farther than its speed allows was placed there by the game [m].
_LEAP = 3.0


def pose_of(snapshot: Snapshot) -> FloatArray:
    """Returns ``(K, 8)`` float32: location [m], rotation (w, x, y, z), forward speed [m/s]."""
    karts = snapshot.karts
    return np.concatenate(
        [karts["location"], karts["rotation"], karts["velocity_lc"][:, 2:]], axis=1
    )


def poses_between(before: Snapshot, after: Snapshot, fractions: npt.ArrayLike) -> FloatArray:
    """Interpolates the poses of all karts between two snapshots of one race.

    Locations follow the cubic Hermite curve through both locations with both velocities. Rotations
    are interpolated linearly and normalized, which is accurate for the small rotations in one step.
    A kart that the game moved elsewhere stays in place until the end.

    Args:
        before: the earlier snapshot.
        after: the later snapshot.
        fractions: ``(T,)``, 0 for the earlier and 1 for the later moment.

    Returns:
        ``(T, K, 8)`` float32, in the form of :func:`pose_of`.
    """
    start, end = pose_of(before), pose_of(after)
    seconds = max(game_time(after) - game_time(before), 1e-3)
    tangents = [s.karts["velocity"] * np.float32(seconds) for s in (before, after)]
    t = np.asarray(fractions, np.float32)[:, None, None]
    places = (
        (2 * t**3 - 3 * t**2 + 1) * start[:, :3]
        + (t**3 - 2 * t**2 + t) * tangents[0]
        + (3 * t**2 - 2 * t**3) * end[:, :3]
        + (t**3 - t**2) * tangents[1]
    )
    far_side = np.where((start[:, 3:7] * end[:, 3:7]).sum(1, keepdims=True) < 0, -1, 1)
    turns = (1 - t) * start[:, 3:7] + t * far_side * end[:, 3:7]
    turns /= np.maximum(np.linalg.norm(turns, axis=-1, keepdims=True), 1e-6)
    speeds = (1 - t) * start[:, 7:] + t * end[:, 7:]
    poses = np.concatenate([places, turns, speeds], axis=-1).astype(np.float32)
    leaps = _has_leapt(before, after, seconds)
    return np.where(leaps[:, None] & (t < 1), start, poses).astype(np.float32)


def _has_leapt(before: Snapshot, after: Snapshot, seconds: float) -> npt.NDArray[np.bool_]:
    way = np.linalg.norm(after.karts["location"] - before.karts["location"], axis=1)
    speed = np.maximum(*(np.linalg.norm(s.karts["velocity"], axis=1) for s in (before, after)))
    leaps: npt.NDArray[np.bool_] = way > 1.5 * speed * seconds + _LEAP
    return leaps


def game_time(snapshot: Snapshot) -> float:
    """Returns the engine's game time [s]; it increases steadily from READY to the end."""
    return float(snapshot.header["time"]) + float(snapshot.header["aux_ticks"]) / 120


def snapshots_between(before: Snapshot, after: Snapshot, number: int) -> list[Snapshot]:
    """Returns ``number`` evenly spaced snapshots after the first one; the last is ``after``.

    The times and the karts' poses (:func:`poses_between`) and velocities are interpolated; other
    values are those of ``after``.
    """
    fractions = np.arange(1, number, dtype=np.float32) / number
    noses = [snapshot.karts["front"] - snapshot.karts["location"] for snapshot in (before, after)]
    moments = []
    for fraction, poses in zip(fractions, poses_between(before, after, fractions), strict=True):
        karts = after.karts.copy()
        karts["location"] = poses[:, :3]
        karts["rotation"] = poses[:, 3:7]
        karts["front"] = poses[:, :3] + (1 - fraction) * noses[0] + fraction * noses[1]
        for name in ("velocity", "velocity_lc"):
            karts[name] += (1 - fraction) * (before.karts[name] - after.karts[name])
        header = after.header.copy()
        for name in ("time", "aux_ticks"):
            header[name] += (1 - fraction) * (before.header[name] - after.header[name])
        moments.append(Snapshot.of(header, karts, after.items))
    return [*moments, after]
