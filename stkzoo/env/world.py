"""Views of the race with the field names of ``pystk2.WorldState``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo._left_out import LeftOutNames
from stkzoo.engine.snapshot import Snapshot
from stkzoo.names import AttachmentType, ItemType, Phase, PowerupType

_FLAGS = ("has_finished_race", "jumping", "is_on_road", "race_result")
#: The game's names of kart models that are not the capitalized name of the model.
_KART_NAMES = {"sara_the_racer": "Pepper", "sara_the_wizard": "Sara"}


@dataclass(frozen=True, slots=True)
class PowerupView:
    """A kart's powerup and how many times it can fire it."""

    Type: ClassVar = PowerupType

    type: PowerupType
    num: int


@dataclass(frozen=True, slots=True)
class AttachmentView:
    """The object attached to a kart and its remaining time [s]."""

    Type: ClassVar = AttachmentType

    type: AttachmentType
    time_left: float


@dataclass(frozen=True, slots=True)
class ItemView:
    """One item on the track."""

    Type: ClassVar = ItemType

    id: int
    type: ItemType
    location: npt.NDArray[np.float32]
    size: float


class KartView:
    """One kart, with every field of :data:`stkzoo.engine.snapshot.KART_DTYPE`.

    Attributes:
        id: index in grid order; also ``player_id``.
        kart_type: name of the model.
        name: name of the model as the game shows it, such as ``"Tux"``.
        lives: 0, as in all races.
        powerup: the kart's powerup.
        attachment: the object attached to the kart.
    """

    def __init__(self, record: Any, kart_id: int, kart_type: str) -> None:
        self._record = record
        self.id = self.player_id = kart_id
        self.kart_type = kart_type
        self.name = _KART_NAMES.get(kart_type, kart_type.capitalize())
        self.lives = 0
        self.powerup = PowerupView(PowerupType(self.powerup_type), self.powerup_num)
        left = self.attachment_time_left
        self.attachment = AttachmentView(AttachmentType(self.attachment_type), left)

    def __getattr__(self, name: str) -> Any:
        record = self.__dict__.get("_record")
        if record is None or name not in record.dtype.names:
            raise AttributeError(f"a kart has no {name!r}")
        value = record[name]
        if isinstance(value, np.ndarray):
            return value.copy()
        return bool(value) if name in _FLAGS else value.item()


@dataclass(frozen=True, slots=True)
class PlayerView:
    """A kart, as a player; no player has a camera."""

    kart: KartView
    camera: None = None


class WorldView(LeftOutNames):
    """One moment of a race.

    Args:
        snapshot: snapshot of the moment.
        kart_types: model of each kart, in grid order.

    Attributes:
        time: time since GO [s].
        aux_ticks: the game's counter of ticks.
        phase: phase of the race, a :class:`stkzoo.names.Phase`.
        karts: all karts, in grid order.
        players: all karts as players.
        items: all items.
    """

    left_out: ClassVar = {
        "Phase": "use stkzoo.Phase",
        "set_kart_location": 'use reset(options={"start": ...})',
        "update": "env.unwrapped.world is always the current state",
        **dict.fromkeys(("ffa", "soccer"), "races are of other modes"),
    }

    def __init__(self, snapshot: Snapshot, kart_types: tuple[str, ...]) -> None:
        self.time = float(snapshot.header["time"])
        self.aux_ticks = float(snapshot.header["aux_ticks"])
        self.phase = Phase(snapshot.phase)
        records = enumerate(zip(snapshot.karts, kart_types, strict=True))
        self.karts = [KartView(record, index, kart_type) for index, (record, kart_type) in records]
        self.players = [PlayerView(kart) for kart in self.karts]
        self.items = [
            ItemView(
                int(item["id"]),
                ItemType(int(item["type"])),
                item["location"].copy(),
                float(item["size"]),
            )
            for item in snapshot.items
        ]
