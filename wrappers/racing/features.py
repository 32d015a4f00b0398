"""The features of the racing view: their layout."""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

import numpy as np
import numpy.typing as npt

from stkzoo.mdp.spaces import STANDING_MIRROR, STANDING_SIZE
from stkzoo.names import AttachmentType, ItemType, PowerupType

#: Distance between the points of a road's line [m].
STEP = 2.0

#: Distances along the line, from the kart, at which the road is observed [m].
MARKS = np.array([3, 6, 10, 14, 19, 25, 32, 40, 50, 62, 76, 92], np.float32)

#: Sampled distances: beside the kart, at the marks, and for headings :data:`BEYOND` farther [m].
BEYOND = 3.0
LOOKS = np.concatenate([[0.0], MARKS, MARKS + BEYOND]).astype(np.float32)

#: Numbers of the nearest other karts, good items ahead and bad items ahead in the view.
KARTS, GOODS, BADS = 4, 4, 3

#: Types of good and of bad items.
GOOD_TYPES = (ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL)
BAD_TYPES = (ItemType.BANANA, ItemType.BUBBLEGUM)

#: Attachments of a kart, in the order of the view.
ATTACHMENTS = tuple(member for member in AttachmentType if member is not AttachmentType.NOTHING)
NUM_POWERUPS = max(PowerupType) + 1


def _names(kinds: Iterable[Enum]) -> str:
    return ", ".join(member.name for member in kinds)


_POWERUPS = f"1 for the power-up that the kart holds: {_names(PowerupType)}"
_ATTACHED = f"1 for what is attached to the kart, all 0 for nothing: {_names(ATTACHMENTS)}"
_GOOD = f"1 for its type: {_names(GOOD_TYPES)}"
_METERS = ", ".join(f"{mark:g}" for mark in MARKS)
_AHEAD = f"points on the line {_METERS} m ahead: position / distance ahead"
_ROOM = "distance from each of these points to the edge of the road"
_HEADING = "the line's direction there: sine and cosine; 0 rad is straight ahead"
#: The view's parts in order: name, number of entries, values per entry, unit and meaning.
_LAYOUT = (
    ("velocity", 1, 3, "20 m/s", "the kart's velocity: right, up, ahead"),
    ("max_steer_angle", 1, 1, "rad", "the wheels' angle at full lock, at the current speed"),
    ("skeed_factor", 1, 1, "", "how much the kart skids; 1 is not at all"),
    ("energy", 1, 1, "20 s", "nitro in the tank"),
    ("attachment_time_left", 1, 1, "10 s", "how long the attachment stays"),
    ("shield_time", 1, 1, "10 s", "how long the shield holds"),
    ("jumping", 1, 1, "", "1 in the air, else 0"),
    ("powerup_type", 1, NUM_POWERUPS, "", _POWERUPS),
    ("powerup_count", 1, 1, "3", "how many times it can be fired"),
    ("attachment", 1, len(ATTACHMENTS), "", _ATTACHED),
    ("line_position", 1, 3, "10 m", "the nearest point of the road's line: right, up, ahead"),
    ("line_room", 1, 1, "10 m", "distance from that point to the edge of the road"),
    ("marks_direction", len(MARKS), 3, "", _AHEAD),
    ("marks_room", len(MARKS), 1, "10 m", _ROOM),
    ("marks_heading", len(MARKS), 2, "", _HEADING),
    ("karts_direction", KARTS, 3, "", "unit vectors to the nearest karts within 60 m"),
    ("karts_nearness", KARTS, 1, "", "1 / (1 + distance / 5 m); 0 where there is none"),
    ("goods_direction", GOODS, 3, "", "unit vectors to the nearest good items ahead, within 60 m"),
    ("goods_nearness", GOODS, 1, "", "1 / (1 + distance / 5 m); 0 where there is none"),
    ("goods_beside", GOODS, 1, "5 m", "how far to the right each of them is"),
    ("goods_type", GOODS, len(GOOD_TYPES), "", _GOOD),
    ("bads_direction", BADS, 3, "", "unit vectors to the nearest bad items ahead, within 60 m"),
    ("bads_nearness", BADS, 1, "", "1 / (1 + distance / 5 m); 0 where there is none"),
    ("bads_beside", BADS, 1, "5 m", "how far to the right each of them is"),
)
#: Number of entries of each part, and values per entry. Entries of parts named ``_position`` or
#: ``_direction`` are x (right), y (up), z (ahead).
PARTS: dict[str, tuple[int, int]] = {name: (count, width) for name, count, width, *_ in _LAYOUT}
#: Unit and meaning of each part.
MEANINGS: dict[str, tuple[str, str]] = {name: (unit, text) for name, *_, unit, text in _LAYOUT}

#: Number of values in the view.
SIZE = sum(count * width for count, width in PARTS.values())


#: Number of values in the view ``contest``: this view, and the standing.
CONTEST_SIZE = SIZE + STANDING_SIZE


_ENDS = np.cumsum([count * width for count, width in PARTS.values()]).tolist()
#: Slice of each part in the view.
PLACES = dict(zip(PARTS, map(slice, [0, *_ENDS], _ENDS), strict=True))


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
#: The same for the view ``contest``.
CONTEST_MIRROR = np.concatenate([MIRROR, STANDING_MIRROR])

#: Entries of the ``full`` view that describe a kart's own state, and their places in
#: :attr:`Surroundings.ego`.
OWN_PLACES = {
    key: slice(begin, begin + width)
    for key, begin, width in (
        *(("velocity", 0, 3), ("max_steer_angle", 3, 1), ("skeed_factor", 4, 1), ("energy", 5, 1)),
        *(("attachment_time_left", 6, 1), ("shield_time", 7, 1), ("jumping", 8, 1)),
        *(("powerup_type", 9, 1), ("powerup_count", 10, 1), ("attachment", 11, 1)),
    )
}
OWN_SIZE = 12

#: Maximum distances of karts and items, and minimum distance ahead and maximum height difference
#: of items [m].
KART_REACH, ITEM_REACH = 60.0, 60.0
ITEM_LEAST_AHEAD, ITEM_LEVEL = 0.5, 6.0

BAD, IGNORED = -1, -2
#: Class by item type: the number of a good item, or a constant above. The last is :data:`ABSENT`.
ITEM_CLASSES = np.full(max(ItemType) + 2, IGNORED, np.int8)
ITEM_CLASSES[list(GOOD_TYPES)] = range(len(GOOD_TYPES))
ITEM_CLASSES[list(BAD_TYPES)] = BAD
#: Index by type of attachment, or -1.
ATTACHMENT_COLUMNS = np.full(16, -1, np.int8)
ATTACHMENT_COLUMNS[list(ATTACHMENTS)] = range(len(ATTACHMENTS))

#: The first arguments of the kernel's ``write_racing_view``.
KERNEL_TABLES = (
    *(LOOKS, ITEM_CLASSES, ATTACHMENT_COLUMNS),
    (NUM_POWERUPS, len(ATTACHMENTS), len(GOOD_TYPES), KARTS, GOODS, BADS),
    (KART_REACH, ITEM_REACH, ITEM_LEAST_AHEAD, ITEM_LEVEL),
)
