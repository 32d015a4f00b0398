"""What the racing view's numbers are and where they stand."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from stkzoo.names import AttachmentType, ItemType, PowerupType

#: Where the road ahead is looked at, from the kart on along the line [m].
MARKS = np.array([3, 6, 10, 14, 19, 25, 32, 40, 50, 62, 76, 92], np.float32)

#: How many of the nearest other karts, good items ahead and bad items ahead are seen.
KARTS, GOODS, BADS = 4, 4, 3

#: What is good and what is bad to drive over.
TYPES_GOOD = (ItemType.BONUS_BOX, ItemType.NITRO_BIG, ItemType.NITRO_SMALL)
TYPES_BAD = (ItemType.BANANA, ItemType.BUBBLEGUM)

#: What can hang on a kart, in the order of the view.
ATTACHMENTS = tuple(kind for kind in AttachmentType if kind is not AttachmentType.NOTHING)
NUM_POWERUPS = max(PowerupType) + 1

_POINTS = len(MARKS)

#: The view's parts in order: name, how many entries, numbers of an entry. Each entry of a part
#: is x (to the right), y (up), z (ahead) where its name says ``_position`` or ``_direction``.
PARTS: dict[str, tuple[int, int]] = {
    "velocity": (1, 3),  # [20 m/s]
    "max_steer_angle": (1, 1),  # [rad]
    "skeed_factor": (1, 1),
    "energy": (1, 1),  # [20]
    "attachment_time_left": (1, 1),  # [10 s]
    "shield_time": (1, 1),  # [10 s]
    "jumping": (1, 1),
    "powerup_type": (1, NUM_POWERUPS),  # one of them is 1
    "powerup_count": (1, 1),  # [3]
    "attachment": (1, len(ATTACHMENTS)),  # one of them is 1, or none
    "line_position": (1, 3),  # the nearest point of the line [10 m]
    "line_room": (1, 1),  # from there to the road's edge [10 m]
    "marks_direction": (_POINTS, 3),  # position over distance along the line
    "marks_room": (_POINTS, 1),  # [10 m]
    "marks_heading": (_POINTS, 2),  # of the line there: sine and cosine, 0 is the kart's
    "karts_direction": (KARTS, 3),  # unit vector
    "karts_nearness": (KARTS, 1),  # 1 / (1 + distance / 5 m); 0 where there is none
    "goods_direction": (GOODS, 3),
    "goods_nearness": (GOODS, 1),
    "goods_beside": (GOODS, 1),  # how far to the right [5 m]
    "goods_type": (GOODS, len(TYPES_GOOD)),  # one of them is 1; 0 where there is none
    "bads_direction": (BADS, 3),
    "bads_nearness": (BADS, 1),
    "bads_beside": (BADS, 1),
}

#: How many numbers the view has.
SIZE = sum(count * width for count, width in PARTS.values())


def _places() -> dict[str, slice]:
    ends = np.cumsum([count * width for count, width in PARTS.values()]).tolist()
    return {name: slice(a, b) for name, a, b in zip(PARTS, [0, *ends], ends, strict=False)}


#: Where in the view each part stands.
PLACES = _places()


def _mirror() -> npt.NDArray[np.float32]:
    signs = []
    for name, (count, width) in PARTS.items():
        entry = np.ones(width, np.float32)
        if name.endswith(("velocity", "_position", "_direction", "_heading", "_beside")):
            entry[0] = -1.0
        signs.append(np.tile(entry, count))
    return np.concatenate(signs)


#: ``(SIZE,)`` of 1 and -1: a view times this is the view of the mirrored race, left for right.
MIRROR = _mirror()
