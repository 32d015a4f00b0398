"""Snapshots: the state of a race at one moment, as arrays.

A :class:`Snapshot` is one block of bytes: header, karts, items. The kernel reads it
directly; Python reads it with numpy's structured types. It is sent between processes as it is,
without pickling. The rest of the library knows a race's state only from snapshots.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import RECORD_SIZES, not_built

#: Names of a kart's controls, in the order of the last axis of control arrays.
CONTROLS = ("acceleration", "steer", "brake", "drift", "fire", "nitro", "rescue")

HEADER_DTYPE = np.dtype(
    [
        ("time", "f4"),  # race clock since GO [s]
        ("aux_ticks", "f4"),  # the engine's physics ticks before GO; constant afterwards
        ("phase", "i4"),  # stkzoo.names.Phase
        ("num_kart", "i4"),
        ("num_items", "i4"),
        ("running", "i4"),  # 0 once every player kart has finished
    ]
)

#: Vectors are in the world frame (meters, y up) unless a comment names another frame.
KART_DTYPE = np.dtype(
    [
        ("location", "f4", 3),  # [m]
        ("rotation", "f4", 4),  # unit quaternion w, x, y, z: world to kart frame
        ("front", "f4", 3),  # center of the front edge [m]
        ("velocity", "f4", 3),  # [m/s]
        ("velocity_lc", "f4", 3),  # [m/s], kart frame: x right, y up, z forward
        ("angular_velocity", "f4", 3),  # [rad/s]
        ("size", "f4", 3),  # width, height, length [m]
        ("speed", "f4"),  # [m/s]
        ("max_steer_angle", "f4"),  # at the current speed [rad]
        ("wheel_base", "f4"),  # [m]
        ("energy", "f4"),  # remaining nitro
        ("skeed_factor", "f4"),  # skid factor, in the engine's spelling; 1 means no skid
        ("shield_time", "f4"),  # [s]
        ("attachment_time_left", "f4"),  # [s]
        ("distance_down_track", "f4"),  # in this lap [m]
        ("overall_distance", "f4"),  # since the start line [m]; negative before it
        ("finish_time", "f4"),  # [s]; 0 until the finish
        ("lap_time", "f4"),  # of the last lap [s]
        ("node", "i4"),  # index of the track node the kart is on
        ("position", "i4"),  # rank, 1 is first
        ("finished_laps", "i4"),  # -1 before the start line
        ("powerup_type", "i4"),  # stkzoo.names.PowerupType
        ("powerup_num", "i4"),
        ("attachment_type", "i4"),  # stkzoo.names.AttachmentType
        ("has_finished_race", "i4"),
        ("race_result", "i4"),
        ("jumping", "i4"),
        ("is_on_road", "i4"),
        # The latest controls of players' karts, and of the game's AI with reports_control.
        ("control", "f4", len(CONTROLS)),
    ]
)

ITEM_DTYPE = np.dtype([("location", "f4", 3), ("size", "f4"), ("type", "i4"), ("id", "i4")])

#: The fields of :data:`HEADER_DTYPE`. Reading a field with numpy takes longer.
_HEADER = struct.Struct("=ffiiii")


if tuple(dtype.itemsize for dtype in (HEADER_DTYPE, KART_DTYPE, ITEM_DTYPE)) != RECORD_SIZES:
    raise not_built("its snapshots have another layout")


@dataclass(frozen=True)
class Snapshot:
    """The state of a race at one moment. Its arrays are read-only views of its bytes.

    Attributes:
        data: the state as one block of bytes: header, karts, items.
    """

    data: bytes = field(repr=False)

    @classmethod
    def of(
        cls, header: np.void, karts: npt.NDArray[np.void], items: npt.NDArray[np.void]
    ) -> Snapshot:
        """Builds a snapshot from its parts and sets the counts in its header.

        Args:
            header: record of :data:`HEADER_DTYPE`; its counts are ignored.
            karts: ``(K,)`` records of :data:`KART_DTYPE`.
            items: ``(M,)`` records of :data:`ITEM_DTYPE`.
        """
        head = np.zeros(1, HEADER_DTYPE)
        head[0] = header
        head["num_kart"], head["num_items"] = len(karts), len(items)
        return cls(head.tobytes() + karts.tobytes() + items.tobytes())

    @cached_property
    def header(self) -> np.void:
        """Scalar record of :data:`HEADER_DTYPE`."""
        header: np.void = np.frombuffer(self.data, HEADER_DTYPE, count=1)[0]
        return header

    @cached_property
    def karts(self) -> npt.NDArray[np.void]:
        """``(K,)`` records of :data:`KART_DTYPE`, in the order of the starting grid."""
        return np.frombuffer(self.data, KART_DTYPE, self._head[3], offset=HEADER_DTYPE.itemsize)

    @cached_property
    def items(self) -> npt.NDArray[np.void]:
        """``(M,)`` records of :data:`ITEM_DTYPE`.

        ``M`` changes during a race when a kart drops bubble gum.
        """
        _, _, _, num_kart, count, _ = self._head
        begin = HEADER_DTYPE.itemsize + num_kart * KART_DTYPE.itemsize
        return np.frombuffer(self.data, ITEM_DTYPE, count, offset=begin)

    @property
    def phase(self) -> int:
        """Number of :class:`stkzoo.names.Phase`."""
        return self._head[2]

    @property
    def running(self) -> bool:
        """Whether any player kart is still racing."""
        return bool(self._head[5])

    @property
    def _head(self) -> tuple[float, float, int, int, int, int]:
        return _HEADER.unpack_from(self.data)
