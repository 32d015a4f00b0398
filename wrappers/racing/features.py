"""The features of the racing view: their layout and their computation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.mdp.geometry import squared
from stkzoo.mdp.spaces import POWERUP_COUNT_LIMIT
from stkzoo.names import AttachmentType, ItemType, PowerupType
from stkzoo.wrappers.racing.road import BEYOND, LOOKS, MARKS, STEP
from stkzoo.wrappers.racing.surroundings import Surroundings

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[Any]

#: Numbers of nearest other karts, good items ahead and bad items ahead in the view.
KARTS, GOODS, BADS = 4, 4, 3

#: Items that help and items that harm.
TYPES_GOOD = (ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL)
TYPES_BAD = (ItemType.BANANA, ItemType.BUBBLEGUM)

#: Attachments of a kart, in the order of the view.
ATTACHMENTS = tuple(kind for kind in AttachmentType if kind is not AttachmentType.NOTHING)
NUM_POWERUPS = max(PowerupType) + 1

#: The view's parts in order: name, number of entries, values per entry. Entries of parts named
#: ``_position`` or ``_direction`` are x (right), y (up), z (ahead).
PARTS: dict[str, tuple[int, int]] = {
    "velocity": (1, 3),
    "max_steer_angle": (1, 1),
    "skeed_factor": (1, 1),
    "energy": (1, 1),
    "attachment_time_left": (1, 1),
    "shield_time": (1, 1),
    "jumping": (1, 1),
    "powerup_type": (1, NUM_POWERUPS),
    "powerup_count": (1, 1),
    "attachment": (1, len(ATTACHMENTS)),
    "line_position": (1, 3),
    "line_room": (1, 1),
    "marks_direction": (len(MARKS), 3),
    "marks_room": (len(MARKS), 1),
    "marks_heading": (len(MARKS), 2),
    "karts_direction": (KARTS, 3),
    "karts_nearness": (KARTS, 1),
    "goods_direction": (GOODS, 3),
    "goods_nearness": (GOODS, 1),
    "goods_beside": (GOODS, 1),
    "goods_type": (GOODS, len(TYPES_GOOD)),
    "bads_direction": (BADS, 3),
    "bads_nearness": (BADS, 1),
    "bads_beside": (BADS, 1),
}

_MARKS = ", ".join(f"{mark:g}" for mark in MARKS)
_POWERUPS = ", ".join(kind.name for kind in PowerupType)
_HANGING = ", ".join(kind.name for kind in ATTACHMENTS)
#: Unit and meaning of each part.
MEANINGS: dict[str, tuple[str, str]] = {
    "velocity": ("20 m/s", "the kart's velocity: right, up, ahead"),
    "max_steer_angle": ("rad", "the wheels' angle at full lock, at this speed"),
    "skeed_factor": ("", "how much the kart skids; 1 is not at all"),
    "energy": ("20 s", "nitro in the tank"),
    "attachment_time_left": ("10 s", "how long the attachment stays"),
    "shield_time": ("10 s", "how long the shield holds"),
    "jumping": ("", "1 in the air, else 0"),
    "powerup_type": ("", f"1 for the power-up that the kart holds: {_POWERUPS}"),
    "powerup_count": ("3", "how often it can fire"),
    "attachment": ("", f"1 for what hangs on the kart, all 0 for nothing: {_HANGING}"),
    "line_position": ("10 m", "the nearest point of the road's line: right, up, ahead"),
    "line_room": ("10 m", "from that point to the edge of the road"),
    "marks_direction": ("", f"points on the line {_MARKS} m ahead: position over distance"),
    "marks_room": ("10 m", "from each of these points to the edge of the road"),
    "marks_heading": ("", "the line's direction there: sine and cosine; 0 rad is the kart's own"),
    "karts_direction": ("", "unit vectors to the nearest karts within 60 m"),
    "karts_nearness": ("", "1 / (1 + distance / 5 m); 0 where there is none"),
    "goods_direction": ("", "unit vectors to the nearest good items ahead, within 60 m"),
    "goods_nearness": ("", "1 / (1 + distance / 5 m); 0 where there is none"),
    "goods_beside": ("5 m", "how far to the right each of them is"),
    "goods_type": ("", f"1 for its type: {', '.join(kind.name for kind in TYPES_GOOD)}"),
    "bads_direction": ("", "unit vectors to the nearest bad items ahead, within 60 m"),
    "bads_nearness": ("", "1 / (1 + distance / 5 m); 0 where there is none"),
    "bads_beside": ("5 m", "how far to the right each of them is"),
}

#: Number of values in the view.
SIZE = sum(count * width for count, width in PARTS.values())


def _places() -> dict[str, slice]:
    ends = np.cumsum([count * width for count, width in PARTS.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(PARTS, [0, *ends], ends, strict=False)}


#: Slice of each part in the view.
PLACES = _places()


def _mirror() -> npt.NDArray[np.float32]:
    signs = []
    for name, (count, width) in PARTS.items():
        entry = np.ones(width, np.float32)
        if name.endswith(("velocity", "_position", "_direction", "_heading", "_beside")):
            entry[0] = -1.0
        signs.append(np.tile(entry, count))
    return np.concatenate(signs)


#: ``(SIZE,)`` of 1 and -1; multiplying a view by it mirrors the race left to right.
MIRROR = _mirror()

#: Continuous entries of the kart's own state, and their scales.
_OWN_UNITS = {
    "velocity": 20.0,
    "max_steer_angle": 1.0,
    "skeed_factor": 1.0,
    "energy": 20.0,
    "attachment_time_left": 10.0,
    "shield_time": 10.0,
    "jumping": 1.0,
    "powerup_count": 3.0,
}

_KART_REACH, _ITEM_REACH = 60.0, 60.0  # [m]
_ITEM_LEAST_AHEAD, _ITEM_LEVEL = 0.5, 6.0  # [m]

_BAD, _IGNORED = -1, -2
#: Class by item type: the number of a good item, or a constant above. The last is :data:`ABSENT`.
_ITEMS = np.full(max(ItemType) + 2, _IGNORED, np.int8)
_ITEMS[list(TYPES_GOOD)] = range(len(TYPES_GOOD))
_ITEMS[list(TYPES_BAD)] = _BAD
#: Index by type of attachment, or -1.
_ATTACHMENTS = np.full(16, -1, np.int8)
_ATTACHMENTS[list(ATTACHMENTS)] = range(len(ATTACHMENTS))

#: Arguments of the kernel's ``RacingObserver`` after a road's ``(lines, starts, along)``.
KERNEL_TABLES = (
    (MARKS, _ITEMS, _ATTACHMENTS),
    (
        *(NUM_POWERUPS, POWERUP_COUNT_LIMIT, len(ATTACHMENTS), len(TYPES_GOOD)),
        *(KARTS, GOODS, BADS),
    ),
    (STEP, BEYOND, _KART_REACH, _ITEM_REACH, _ITEM_LEAST_AHEAD, _ITEM_LEVEL),
)


def racing_features(own: Mapping[str, Any], around: Surroundings) -> FloatArray:
    """Returns the view of A karts.

    Args:
        own: entries of the ``full`` view in batch form.
        around: surroundings of the karts.

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
    for name, unit in _OWN_UNITS.items():
        view[:, PLACES[name]] = np.reshape(own[name], (len(view), -1)) / unit
    view[:, PLACES["powerup_type"]] = _one_of(own["powerup_type"], NUM_POWERUPS)
    hanging = _ATTACHMENTS[own["attachment"]]
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
    kinds = _ITEMS[types]
    for name, is_one, count in (("goods", kinds >= 0, GOODS), ("bads", kinds == _BAD, BADS)):
        seen, there, order = _nearest(items, squares, is_seen & is_one, count)
        _write_places(view, name, seen, there)
        view[:, PLACES[f"{name}_beside"]] = seen[..., 0] / 5.0
        if name == "goods":
            found = there[:, : order.shape[1], None]
            chosen = np.take_along_axis(kinds, order, axis=1)
            types_seen = _padded(_one_of(chosen, len(TYPES_GOOD)) * found, count)
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
