"""Observations of karts in the ``full`` view in NumPy, for several karts at once.

In batch form, every key of :func:`stkzoo.mdp.spaces.kart_observation_space` has a leading axis of A
agents; sequences are rectangular ``(A, M, ...)`` arrays. Positions are in the frame of the
observing kart: x right, y up, z forward [m].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.mdp.spaces import POWERUP_COUNT_LIMIT

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
Batch = dict[str, Any]
_Kind = TypeVar("_Kind", bound=np.generic)


def observe_karts(
    track: Any,
    kart_types: Sequence[str],
    snapshot: Snapshot,
    karts: IntArray,
    max_paths: int | None = None,
) -> Batch:
    """Returns the observations of some karts in the ``full`` view, in batch form.

    Args:
        track: map of the track.
        kart_types: model of each kart, in grid order.
        snapshot: current snapshot.
        karts: ``(A,)`` indices of the observing karts.
        max_paths: number of track segments ahead; ``None`` for all.
    """
    records = snapshot.karts[karts]
    ahead = track.nodes_ahead(records["node"], max_paths)
    front, own_node, items, others, ahead_ends = _seen(track, snapshot, records, karts, ahead)
    return {
        "kart_type": np.array(kart_types)[karts],
        "aux_ticks": np.full((len(records), 1), snapshot.header["aux_ticks"], np.float32),
        "phase": np.full(len(records), snapshot.phase, np.int64),
        **own_state(records),
        "front": front[:, 0],
        **_center_path(own_node),
        **_items(snapshot, items),
        "karts_position": _in_order(others, _nearest_first(others)),
        "paths_distance": track.path_distance[ahead],
        "paths_width": track.path_width[ahead],
        "paths_start": ahead_ends[:, ::2],
        "paths_end": ahead_ends[:, 1::2],
    }


def karts_motion(snapshot: Snapshot, karts: IntArray) -> Batch:
    """Returns the motion of the other karts, in the order of ``karts_position``.

    Args:
        snapshot: current snapshot.
        karts: ``(A,)`` indices of the observing karts.

    Returns:
        ``karts_velocity``, ``(A, K - 1, 3)`` float32, velocity over the ground in the observing
            kart's frame [m/s]; and ``karts_heading``, ``(A, K - 1, 1)`` float32, heading relative
            to the observing kart, positive to the right, seen from above it [rad].
    """
    records, others = snapshot.karts[karts], _others(snapshot, karts)
    own = rotation_matrices(records["rotation"])
    order = _nearest_first(
        to_kart_frame(snapshot.karts["location"][others], records["location"], own)
    )
    seen, origin = snapshot.karts[_in_order(others, order)], np.zeros((len(karts), 3), np.float32)
    forwards = rotation_matrices(seen["rotation"])[..., 2, :]
    forward = to_kart_frame(forwards, origin, own)
    return {
        "karts_velocity": to_kart_frame(seen["velocity"], origin, own),
        "karts_heading": np.arctan2(forward[..., :1], forward[..., 2:]),
    }


def _others(snapshot: Snapshot, karts: IntArray) -> IntArray:
    """Returns the indices of all other karts for each kart, ``(A, K - 1)``."""
    others = np.arange(len(snapshot.karts) - 1)[None] + np.zeros((len(karts), 1), np.intp)
    others += others >= karts[:, None]
    return others


def _seen(
    track: Any, snapshot: Snapshot, records: Any, karts: IntArray, ahead: IntArray
) -> list[FloatArray]:
    """Transforms all observed points to the karts' frames in one operation.

    Returns:
        ``(A, n, 3)`` float32 each: the kart's front, both ends of its track segment, the items, the
            other karts, and the ends of the segments ahead (start and end alternate).
    """
    nodes, count = track.path_nodes, len(records)
    groups = (
        records["front"][:, None],
        nodes[records["node"]],
        np.broadcast_to(snapshot.items["location"], (count, len(snapshot.items), 3)),
        snapshot.karts["location"][_others(snapshot, karts)],
        nodes[ahead].reshape(count, -1, 3),
    )
    points = np.concatenate(groups, axis=1)
    seen = to_kart_frame(points, records["location"], rotation_matrices(records["rotation"]))
    ends = np.cumsum([group.shape[1] for group in groups]).tolist()
    return [seen[:, begin:end] for begin, end in zip([0, *ends], ends, strict=False)]


#: Observation keys of the kart's own state, and their fields of ``KART_DTYPE``.
_NUMBERS = {
    "attachment_time_left": "attachment_time_left",
    "max_steer_angle": "max_steer_angle",
    "energy": "energy",
    "skeed_factor": "skeed_factor",
    "shield_time": "shield_time",
    "distance_down_track": "distance_down_track",
    "velocity": "velocity_lc",
}
_CHOICES = {
    "powerup_type": "powerup_type",
    "powerup_count": "powerup_num",
    "attachment": "attachment_type",
    "jumping": "jumping",
}


def own_state(records: Any) -> Batch:
    """Returns the observation entries of the karts' own state, from their records ``(A,)``."""
    count = len(records)
    numbers = {key: records[field].reshape(count, -1) for key, field in _NUMBERS.items()}
    choices = {key: records[field].astype(np.int64) for key, field in _CHOICES.items()}
    choices["powerup_count"] = np.minimum(choices["powerup_count"], POWERUP_COUNT_LIMIT)
    return numbers | choices


def _center_path(ends: FloatArray) -> Batch:
    """Returns the offset from the center line of the segment with the ends ``(A, 2, 3)``.

    ``center_path`` is the vector to the kart from the nearest point of the infinite line.
    ``center_path_distance`` is its length, negative when the line is to the right of the kart.
    """
    start, along = ends[:, 0], ends[:, 0] - ends[:, 1]
    length_squared = (along * along).sum(-1, keepdims=True)
    share = (along * start).sum(-1, keepdims=True) / np.where(length_squared > 0, length_squared, 1)
    from_line = np.where(length_squared > 0, share * along - start, 0).astype(np.float32)
    # np.sign would return 0 for a line straight ahead, and lose its distance.
    side = np.where(from_line[:, 0] < 0, -1, 1)
    distance = np.linalg.norm(from_line, axis=-1) * side
    return {"center_path": from_line, "center_path_distance": distance[:, None].astype(np.float32)}


def _items(snapshot: Snapshot, positions: FloatArray) -> Batch:
    order = _nearest_first(positions)
    return {
        "items_position": _in_order(positions, order),
        "items_type": snapshot.items["type"][order].astype(np.int64),
    }


def _in_order(values: npt.NDArray[_Kind], order: IntArray) -> npt.NDArray[_Kind]:
    return values[np.arange(len(order))[:, None], order]


def _nearest_first(positions: FloatArray) -> IntArray:
    """Returns the order of points ``(A, M, 3)``: those in front by distance, then those behind."""
    distances = np.linalg.norm(positions, axis=-1)
    is_behind = positions[..., 2] < 0
    return np.lexsort((distances, is_behind), axis=-1)


def to_polar(positions: FloatArray) -> FloatArray:
    x, y, z = positions[..., 0], positions[..., 1], positions[..., 2]
    polar = np.empty_like(positions)
    polar[..., 0] = np.arctan2(x, z)
    polar[..., 1] = np.arctan2(y, z)
    polar[..., 2] = np.linalg.norm(positions, axis=-1)
    return polar
