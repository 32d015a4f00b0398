"""The NumPy implementation of ``racing_observer.c``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, KART_DTYPE, Snapshot
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.mdp.spaces import STANDING_SIZE
from stkzoo.wrappers.racing.features import (
    ATTACHMENT_COLUMNS,
    ATTACHMENTS,
    BAD,
    BADS,
    GOOD_TYPES,
    GOODS,
    ITEM_CLASSES,
    ITEM_LEAST_AHEAD,
    ITEM_LEVEL,
    ITEM_REACH,
    KART_REACH,
    KARTS,
    LOOKS,
    MARKS,
    NUM_POWERUPS,
    OWN_PLACES,
    OWN_SIZE,
    PLACES,
    SIZE,
)
from tests.oracle.observations import own_state
from tests.oracle.vectors import line_places, squared

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[Any]
Arrays = tuple[npt.NDArray[Any], ...]

_RIVALS = 4
#: Continuous entries of the kart's own state, and their scales.
OWN_UNITS = {
    "velocity": 20.0,
    "max_steer_angle": 1.0,
    "skeed_factor": 1.0,
    "energy": 20.0,
    "attachment_time_left": 10.0,
    "shield_time": 10.0,
    "jumping": 1.0,
    "powerup_count": 3.0,
}


def observe_racing(
    road: tuple[Any, ...],
    tables: tuple[Any, ...],
    data: bytes,
    who: IntArray,
    rows: IntArray,
    out: FloatArray,
) -> None:
    snapshot = Snapshot(data)
    sizes = (OWN_SIZE,), (len(LOOKS), 4), (len(snapshot.karts), 3), (len(snapshot.items), 3)
    parts = [np.empty((len(who), *size), np.float32) for size in sizes]
    around = *parts, np.empty((len(who), len(snapshot.items)), np.int64)
    look_around(road, data, who, LOOKS, around)
    view = np.empty((len(who), SIZE), np.float32)
    write_racing_view(tables, around, view)
    out[rows, :SIZE] = view


def observe_standing(
    data: bytes,
    teams: IntArray,
    race_length: float,
    who: IntArray,
    rows: IntArray,
    out: FloatArray,
    column: int,
) -> None:
    snapshot = Snapshot(data)
    karts, mine = snapshot.karts, _records(snapshot, who)
    locations, matrices = _frames(mine)
    places = to_kart_frame(karts["location"][None], locations, matrices)
    moves = to_kart_frame(karts["velocity"][None], mine["velocity"], matrices)
    lead = karts["overall_distance"] - mine["overall_distance"][:, None]
    is_mate = (teams == teams[who][:, None]) & (teams >= 0)
    is_there = np.ones_like(lead)
    unit = np.float32(20.0)
    rivals = np.dstack([is_there, places / unit, moves / unit, lead / unit, is_mate])
    distances = squared(places)
    distances[np.arange(len(who)), who] = np.inf
    nearest = distances.argsort(axis=1, kind="stable")[:, : min(_RIVALS, len(karts) - 1)]
    seen = np.zeros((len(who), _RIVALS, rivals.shape[2]), np.float32)
    seen[:, : nearest.shape[1]] = np.take_along_axis(rivals, nearest[..., None], axis=1)
    own = np.column_stack(
        [
            (mine["position"] - 1) / max(len(karts) - 1, 1),
            mine["overall_distance"] / np.float32(race_length),
            mine["control"][:, CONTROLS.index("steer")],
            mine["control"][:, CONTROLS.index("drift")],
        ]
    )
    standing = np.hstack([own, seen.reshape(len(who), -1)])
    out[rows, column : column + STANDING_SIZE] = np.clip(standing, -5.0, 5.0)


def look_around(
    road: tuple[Any, ...],
    data: bytes,
    who: IntArray,
    looks: FloatArray,
    around: Arrays,
) -> None:
    lines, starts, along, step = road
    snapshot = Snapshot(data)
    state, (own, points, karts, items, types) = own_state(snapshot.karts[who]), around
    for key, place in OWN_PLACES.items():
        own[:, place] = np.reshape(state[key], (len(who), -1))
    records = _records(snapshot, who)
    locations, matrices = _frames(records)
    nodes = records["node"]
    segments = starts[nodes] - locations, along[nodes]
    before, share = line_places(*segments, looks, step, lines.shape[1])
    first, second = lines[nodes[:, None], before], lines[nodes[:, None], before + 1]
    line = first + (second - first) * share[..., None]
    points[..., :3] = to_kart_frame(line[..., :3], locations, matrices)
    points[..., 3] = line[..., 3]
    others, things = snapshot.karts["location"][None], snapshot.items["location"][None]
    karts[:], items[:], types[:] = np.inf, 0, -1
    karts[:, : others.shape[1]] = to_kart_frame(others, locations, matrices)
    karts[np.arange(len(who)), who] = np.inf
    items[:, : things.shape[1]] = to_kart_frame(things, locations, matrices)
    types[:, : things.shape[1]] = snapshot.items["type"]


def write_racing_view(tables: tuple[Any, ...], around: Arrays, out: FloatArray) -> None:
    del tables
    view = out[:, :SIZE]
    state, road, karts, items, types = around
    own = {key: state[:, place] for key, place in OWN_PLACES.items()}
    _write_own(view, own)
    _write_road(view, road)
    _write_karts(view, karts)
    _write_items(view, items, types)
    np.clip(view, -5.0, 5.0, out=view)


def _records(snapshot: Snapshot, who: npt.NDArray[np.intp]) -> npt.NDArray[Any]:
    return np.frombuffer(snapshot.karts[who].tobytes(), KART_DTYPE)


def _frames(records: npt.NDArray[Any]) -> tuple[FloatArray, FloatArray]:
    """Returns the karts' locations ``(n, 3)`` and rotation matrices ``(n, 3, 3)``."""
    rotations = np.ascontiguousarray(records["rotation"])
    return records["location"], rotation_matrices(rotations)


def _write_own(view: FloatArray, own: dict[str, npt.NDArray[Any]]) -> None:
    for name, unit in OWN_UNITS.items():
        view[:, PLACES[name]] = np.reshape(own[name], (len(view), -1)) / unit
    view[:, PLACES["powerup_type"]] = _one_of(own["powerup_type"][:, 0], NUM_POWERUPS)
    hanging = ATTACHMENT_COLUMNS[own["attachment"][:, 0].astype(np.intp)]
    view[:, PLACES["attachment"]] = _one_of(hanging, len(ATTACHMENTS))


def _write_road(view: FloatArray, road: FloatArray) -> None:
    count = len(MARKS)
    beside, marks, beyond = road[:, 0], road[:, 1 : count + 1], road[:, count + 1 : len(LOOKS)]
    view[:, PLACES["line_position"]] = beside[:, :3] / 10.0
    view[:, PLACES["line_room"]] = beside[:, 3:] / 10.0
    directions = marks[..., :3] / MARKS[:, None]
    view[:, PLACES["marks_direction"]] = directions.reshape(len(view), -1)
    view[:, PLACES["marks_room"]] = marks[..., 3] / 10.0
    heading = (beyond - marks)[..., [0, 2]]
    length = np.sqrt((heading * heading).sum(-1, keepdims=True))
    view[:, PLACES["marks_heading"]] = (heading / np.maximum(length, 0.1)).reshape(len(view), -1)


def _write_karts(view: FloatArray, karts: FloatArray) -> None:
    squares = squared(karts)
    near, there, _ = _nearest(karts, squares, squares < KART_REACH**2, KARTS)
    _write_places(view, "karts", near, there)


def _write_items(view: FloatArray, items: FloatArray, types: IntArray) -> None:
    squares = squared(items)
    is_seen = (
        (items[..., 2] > ITEM_LEAST_AHEAD)
        & (np.abs(items[..., 1]) < ITEM_LEVEL)
        & (squares < ITEM_REACH**2)
    )
    kinds = ITEM_CLASSES[types]
    for name, is_one, count in (("goods", kinds >= 0, GOODS), ("bads", kinds == BAD, BADS)):
        seen, there, order = _nearest(items, squares, is_seen & is_one, count)
        _write_places(view, name, seen, there)
        view[:, PLACES[f"{name}_beside"]] = seen[..., 0] / 5.0
        if name == "goods":
            found = there[:, : order.shape[1], None]
            chosen = np.take_along_axis(kinds, order, axis=1)
            types_seen = _padded(_one_of(chosen, len(GOOD_TYPES)) * found, count)
            view[:, PLACES["goods_type"]] = types_seen.reshape(len(view), -1)


def _write_places(view: FloatArray, name: str, points: FloatArray, there: FloatArray) -> None:
    distances = np.sqrt(squared(points))
    directions = points / np.maximum(distances, 0.5)[..., None]
    view[:, PLACES[f"{name}_direction"]] = directions.reshape(len(view), -1)
    view[:, PLACES[f"{name}_nearness"]] = there / (1.0 + distances / 5.0)


def _nearest(
    points: FloatArray, squares: FloatArray, is_seen: npt.NDArray[np.bool_], count: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Returns the nearest visible points, padded with zeros, and their order.

    Returns:
        Points ``(A, count, 3)``, a mask ``(A, count)`` of 1 and 0, and indices ``(A, up to
            count)``.
    """
    keys = np.where(is_seen, squares, np.inf)
    order = np.argsort(keys, axis=1, kind="stable")[:, :count]
    rows = np.arange(len(order))[:, None]
    found, near = is_seen[rows, order], points[rows, order]
    near = np.where(found[..., None], near, 0).astype(np.float32)
    return _padded(near, count), _padded(found.astype(np.float32), count), order


def _one_of(numbers: IntArray, count: int) -> FloatArray:
    """Returns the one-hot encoding of numbers below ``count``."""
    return np.equal(numbers[..., None], np.arange(count)).astype(np.float32)


def _padded(rows: FloatArray, count: int) -> FloatArray:
    """Pads rows ``(A, n, ...)`` with zeros to ``(A, count, ...)``."""
    missing = count - rows.shape[1]
    if not missing:
        return rows
    shape = (rows.shape[0], missing, *rows.shape[2:])
    return np.concatenate([rows, np.zeros(shape, rows.dtype)], axis=1)
