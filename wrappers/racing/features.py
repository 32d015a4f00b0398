"""The racing view's numbers from what a kart knows of itself and what is around it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.mdp.geometry import squared
from stkzoo.mdp.spaces import POWERUP_COUNT_LIMIT
from stkzoo.names import ItemType
from stkzoo.wrappers.racing.layout import (
    ATTACHMENTS,
    BADS,
    GOODS,
    KARTS,
    MARKS,
    NUM_POWERUPS,
    PLACES,
    SIZE,
    TYPES_BAD,
    TYPES_GOOD,
)
from stkzoo.wrappers.racing.road import STEP
from stkzoo.wrappers.racing.surroundings import BEYOND, LOOKS, Surroundings

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[Any]

_KART_REACH, _ITEM_REACH = 60.0, 60.0  # [m]
_ITEM_LEAST_AHEAD, _ITEM_LEVEL = 0.5, 6.0  # [m]

_WORTH = np.zeros(max(ItemType) + 2, np.int8)  # the last is ABSENT
_WORTH[list(TYPES_GOOD)] = 1
_WORTH[list(TYPES_BAD)] = -1
_GOOD_ROWS = np.zeros((max(ItemType) + 2, len(TYPES_GOOD)), np.float32)
_GOOD_ROWS[list(TYPES_GOOD), range(len(TYPES_GOOD))] = 1.0
_POWERUP_ROWS = np.eye(NUM_POWERUPS, dtype=np.float32)
_ATTACHMENT_ROWS = np.zeros((16, len(ATTACHMENTS)), np.float32)
_ATTACHMENT_ROWS[list(ATTACHMENTS), range(len(ATTACHMENTS))] = 1.0


def _kernel_tables() -> tuple[tuple[Any, ...], ...]:
    """The same constants and tables as the kernel's ``Racing`` takes them."""
    items = np.full(max(ItemType) + 1, -2, np.int8)
    items[list(TYPES_GOOD)] = range(len(TYPES_GOOD))
    items[list(TYPES_BAD)] = -1
    attachments = np.full(len(_ATTACHMENT_ROWS), -1, np.int8)
    attachments[list(ATTACHMENTS)] = range(len(ATTACHMENTS))
    columns = NUM_POWERUPS, POWERUP_COUNT_LIMIT, len(ATTACHMENTS), len(TYPES_GOOD)
    lengths = STEP, BEYOND, _KART_REACH, _ITEM_REACH, _ITEM_LEAST_AHEAD, _ITEM_LEVEL
    return (MARKS, items, attachments), (*columns, KARTS, GOODS, BADS), lengths


#: What the kernel's ``Racing`` takes after a road's ``(lines, starts, along)``.
KERNEL_TABLES = _kernel_tables()


def racing_features(own: Mapping[str, Any], around: Surroundings) -> FloatArray:
    """The view of A karts.

    Args:
        own: entries of the ``full`` view in batch form.
        around: what is around them.

    Returns:
        ``(A, SIZE)`` float32.
    """
    view = np.empty((len(around.road), SIZE), np.float32)
    _write_own(view, own)
    _write_road(view, around.road)
    _write_karts(view, around.karts)
    _write_items(view, around)
    return np.clip(view, -5.0, 5.0, out=view)


def _write_own(view: FloatArray, own: Mapping[str, Any]) -> None:
    view[:, PLACES["velocity"]] = own["velocity"] / 20.0
    view[:, PLACES["max_steer_angle"]] = own["max_steer_angle"]
    view[:, PLACES["skeed_factor"]] = own["skeed_factor"]
    view[:, PLACES["energy"]] = own["energy"] / 20.0
    view[:, PLACES["attachment_time_left"]] = own["attachment_time_left"] / 10.0
    view[:, PLACES["shield_time"]] = own["shield_time"] / 10.0
    view[:, PLACES["jumping"]] = np.reshape(own["jumping"], (-1, 1))
    view[:, PLACES["powerup_type"]] = _POWERUP_ROWS[own["powerup_type"]]
    view[:, PLACES["powerup_count"]] = np.reshape(own["powerup_count"], (-1, 1)) / 3.0
    view[:, PLACES["attachment"]] = _ATTACHMENT_ROWS[own["attachment"]]


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
    near, there, _ = _nearest(karts, squares, squares < _KART_REACH**2, KARTS)
    _write_places(view, "karts", near, there)


def _write_items(view: FloatArray, around: Surroundings) -> None:
    items, types = around.items, around.item_types
    squares = squared(items)
    is_seen = (
        (items[..., 2] > _ITEM_LEAST_AHEAD)
        & (np.abs(items[..., 1]) < _ITEM_LEVEL)
        & (squares < _ITEM_REACH**2)
    )
    worth = _WORTH[types]
    for name, sign, count in (("goods", 1, GOODS), ("bads", -1, BADS)):
        seen, there, order = _nearest(items, squares, is_seen & (worth == sign), count)
        _write_places(view, name, seen, there)
        view[:, PLACES[f"{name}_beside"]] = seen[..., 0] / 5.0
        if name == "goods":
            found = there[:, : order.shape[1], None]
            kinds = _GOOD_ROWS[types[np.arange(len(types))[:, None], order]] * found
            view[:, PLACES["goods_type"]] = _padded(kinds, count).reshape(len(view), -1)


def _write_places(view: FloatArray, name: str, points: FloatArray, there: FloatArray) -> None:
    distances = np.sqrt(squared(points))
    directions = points / np.maximum(distances, 0.5)[..., None]
    view[:, PLACES[f"{name}_direction"]] = directions.reshape(len(view), -1)
    view[:, PLACES[f"{name}_nearness"]] = there / (1.0 + distances / 5.0)


def _nearest(
    points: FloatArray, squares: FloatArray, is_seen: npt.NDArray[np.bool_], count: int
) -> tuple[FloatArray, FloatArray, IntArray]:
    """The nearest points that are seen, zeros where there are fewer; and their order.

    Returns:
        ``(A, count, 3)``, ``(A, count)`` of 1 and 0, and indices ``(A, up to count)``.
    """
    keys = np.where(is_seen, squares, np.inf)
    order = np.argsort(keys, axis=1, kind="stable")[:, :count]
    rows = np.arange(len(order))[:, None]
    found, near = is_seen[rows, order], points[rows, order]
    near = np.where(found[..., None], near, 0).astype(np.float32)
    return _padded(near, count), _padded(found.astype(np.float32), count), order


def _padded(rows: FloatArray, count: int) -> FloatArray:
    """Rows ``(A, n, ...)`` with zeros behind them up to ``count``."""
    missing = count - rows.shape[1]
    if not missing:
        return rows
    shape = (rows.shape[0], missing, *rows.shape[2:])
    return np.concatenate([rows, np.zeros(shape, rows.dtype)], axis=1)
