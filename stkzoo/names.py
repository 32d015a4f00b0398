"""Enumerations of the numeric codes in observations and infos; most are the engine's own.

Importing this module does not load the engine. When the engine starts, :mod:`stkzoo.engine.race`
compares the numbers of powerups, attachments and items with those of the engine.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

__all__ = [
    "AttachmentType",
    "CameraMode",
    "EndReason",
    "GroundKind",
    "ItemType",
    "Phase",
    "PowerupType",
]


class Phase(IntEnum):
    """Phase of the race, in the observation entry ``phase``."""

    READY_PHASE = 0
    SET_PHASE = 1
    GO_PHASE = 2
    RACE_PHASE = 3

    @classmethod
    def from_stk(cls, source: Any) -> Phase:
        """Returns the phase for one of this class or of ``pystk2.WorldState.Phase``.

        Args:
            source: the phase; ``None`` is READY_PHASE, and phases without a name here RACE_PHASE.
        """
        name = "READY_PHASE" if source is None else source.name
        return cls.__members__.get(name, cls.RACE_PHASE)


class PowerupType(IntEnum):
    """Powerup that a kart can fire, in the observation entry ``powerup_type``."""

    NOTHING = 0
    BUBBLEGUM = 1
    CAKE = 2
    BOWLING = 3
    ZIPPER = 4
    PLUNGER = 5
    SWITCH = 6
    SWATTER = 7
    RUBBERBALL = 8
    PARACHUTE = 9
    ANVIL = 10


class AttachmentType(IntEnum):
    """Object attached to a kart, in the observation entry ``attachment``.

    The gaps in the numbering never occur.
    """

    PARACHUTE = 0
    ANVIL = 1
    BOMB = 2
    SWATTER = 3
    BUBBLEGUM_SHIELD = 6
    NOTHING = 9


class ItemType(IntEnum):
    """Kind of an item on the track, in the observation entry ``items_type``.

    The gaps in the numbering never occur.
    """

    BONUS_BOX = 0
    BANANA = 1
    NITRO_BIG = 2
    NITRO_SMALL = 3
    BUBBLEGUM = 4
    EASTER_EGG = 6


class CameraMode(IntEnum):
    """Whether a kart has its own camera when the game renders the race."""

    AUTO = 0
    ON = 1
    OFF = 2


class GroundKind(IntEnum):
    """Kind of surface in the observation entry ``ground_kind``. stkzoo defines these numbers."""

    VOID = 0  # no ground, or ground that resets karts to the road
    GROUND = 1
    SLOWED = 2  # reduces the top speed
    ZIPPER = 3  # accelerates karts
    WALL = 4


class EndReason(IntEnum):
    """Why an agent's episode ended, in the entry ``ended_by`` of infos."""

    NONE = 0  # it has not ended
    FINISH = 1
    OFF_ROAD = 2
    WRONG_WAY = 3
    STUCK = 4
    FIRST_FINISH = 5  # of another kart
    MAX_CYCLES = 6
