"""The features of the racing view: their layout."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo.names import AttachmentType, ItemType, PowerupType
from stkzoo.wrappers.racing.road import BEYOND, MARKS, STEP

#: Numbers of the nearest other karts, good items ahead and bad items ahead in the view.
KARTS, GOODS, BADS = 4, 4, 3

#: Types of good and of bad items.
TYPES_GOOD = (ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL)
TYPESBAD = (ItemType.BANANA, ItemType.BUBBLEGUM)

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
    "max_steer_angle": ("rad", "the wheels' angle at full lock, at the current speed"),
    "skeed_factor": ("", "how much the kart skids; 1 is not at all"),
    "energy": ("20 s", "nitro in the tank"),
    "attachment_time_left": ("10 s", "how long the attachment stays"),
    "shield_time": ("10 s", "how long the shield holds"),
    "jumping": ("", "1 in the air, else 0"),
    "powerup_type": ("", f"1 for the power-up that the kart holds: {_POWERUPS}"),
    "powerup_count": ("3", "how many times it can be fired"),
    "attachment": ("", f"1 for what is attached to the kart, all 0 for nothing: {_HANGING}"),
    "line_position": ("10 m", "the nearest point of the road's line: right, up, ahead"),
    "line_room": ("10 m", "distance from that point to the edge of the road"),
    "marks_direction": ("", f"points on the line {_MARKS} m ahead: position / distance ahead"),
    "marks_room": ("10 m", "distance from each of these points to the edge of the road"),
    "marks_heading": ("", "the line's direction there: sine and cosine; 0 rad is straight ahead"),
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

#: Entries of the ``full`` view that the features use, as floats and as integers.
OWN_NUMBERS = (
    *("velocity", "max_steer_angle", "skeed_factor"),
    *("energy", "attachment_time_left", "shield_time"),
)
OWN_KINDS = ("jumping", "powerup_type", "powerup_count", "attachment")

#: Maximum distances of karts and items, and minimum distance ahead and maximum height difference
#: of items [m].
KART_REACH, ITEM_REACH = 60.0, 60.0
ITEM_LEAST_AHEAD, ITEM_LEVEL = 0.5, 6.0

BAD, IGNORED = -1, -2
#: Class by item type: the number of a good item, or a constant above. The last is :data:`ABSENT`.
ITEM_CLASSES = np.full(max(ItemType) + 2, IGNORED, np.int8)
ITEM_CLASSES[list(TYPES_GOOD)] = range(len(TYPES_GOOD))
ITEM_CLASSES[list(TYPESBAD)] = BAD
#: Index by type of attachment, or -1.
ATTACHMENT_COLUMNS = np.full(16, -1, np.int8)
ATTACHMENT_COLUMNS[list(ATTACHMENTS)] = range(len(ATTACHMENTS))

#: Arguments of the kernel's ``RacingObserver`` after the roads.
KERNEL_TABLES = (
    (MARKS, ITEM_CLASSES, ATTACHMENT_COLUMNS),
    (
        *(NUM_POWERUPS, len(ATTACHMENTS), len(TYPES_GOOD)),
        *(KARTS, GOODS, BADS),
    ),
    (STEP, BEYOND, KART_REACH, ITEM_REACH, ITEM_LEAST_AHEAD, ITEM_LEVEL),
)
