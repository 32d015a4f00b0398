"""Numbered kinds by name; those of the game have the engine's own numbers.

The engine is not loaded for this; when a race starts, the numbers are checked
against the engine that runs it (:mod:`stkzoo.engine.race`).
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["AttachmentType", "CameraMode", "GroundKind", "ItemType", "Phase", "PowerupType"]


class Phase(IntEnum):
    """Part of the race, as observations carry it under ``phase``."""

    READY_PHASE = 0
    SET_PHASE = 1
    GO_PHASE = 2
    RACE_PHASE = 3


class PowerupType(IntEnum):
    """What a kart can fire (``powerup_type``)."""

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
    """What hangs on a kart (``attachment``). Other numbers do not occur."""

    PARACHUTE = 0
    ANVIL = 1
    BOMB = 2
    SWATTER = 3
    BUBBLEGUM_SHIELD = 6
    NOTHING = 9


class ItemType(IntEnum):
    """What lies on the track (``items_type``). Other numbers do not occur."""

    BONUS_BOX = 0
    BANANA = 1
    NITRO_BIG = 2
    NITRO_SMALL = 3
    BUBBLEGUM = 4
    EASTER_EGG = 6


class CameraMode(IntEnum):
    """Whether a kart has a camera of its own when the game draws itself."""

    AUTO = 0
    ON = 1
    OFF = 2


class GroundKind(IntEnum):
    """What karts drive on and run into (``ground_kind``): numbers of stkzoo, not the game's."""

    VOID = 0  # nothing to drive on, or what puts karts back
    GROUND = 1
    SLOWED = 2  # keeps only a share of a kart's greatest speed
    ZIPPER = 3  # throws karts ahead
    WALL = 4
