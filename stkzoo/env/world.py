"""Views of the race with the field names of ``pystk2.WorldState``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.names import AttachmentType, ItemType, Phase, PowerupType

_FLAGS = ("has_finished_race", "jumping", "is_on_road", "race_result")


@dataclass(frozen=True, slots=True)
class PowerupView:
    """A kart's powerup and how many times it can fire it."""

    type: PowerupType
    num: int


@dataclass(frozen=True, slots=True)
class AttachmentView:
    """The object attached to a kart and its remaining time [s]."""

    type: AttachmentType
    time_left: float


@dataclass(frozen=True, slots=True)
class ItemView:
    """One item on the track."""

    id: int
    type: ItemType
    location: npt.NDArray[np.float32]
    size: float


class KartView:
    """One kart, with every field of :data:`stkzoo.engine.snapshot.KART_DTYPE`.

    Attributes:
        id: index in grid order.
        kart_type: name of the model.
        powerup: the kart's powerup.
        attachment: the object attached to the kart.
    """

    def __init__(self, record: Any, kart_id: int, kart_type: str) -> None:
        self._record = record
        self.id = kart_id
        self.kart_type = kart_type
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


class WorldView:
    """One moment of a race.

    Args:
        snapshot: snapshot of the moment.
        kart_types: model of each kart, in grid order.

    Attributes:
        time: time since GO [s].
        aux_ticks: the game's counter of ticks.
        phase: phase of the race.
        karts: all karts, in grid order.
        items: all items.
    """

    def __init__(self, snapshot: Snapshot, kart_types: tuple[str, ...]) -> None:
        self.time = float(snapshot.header["time"])
        self.aux_ticks = float(snapshot.header["aux_ticks"])
        self.phase = Phase(snapshot.phase)
        records = enumerate(zip(snapshot.karts, kart_types, strict=True))
        self.karts = [KartView(record, index, kart_type) for index, (record, kart_type) in records]
        self.items = [
            ItemView(
                int(item["id"]),
                ItemType(int(item["type"])),
                item["location"].copy(),
                float(item["size"]),
            )
            for item in snapshot.items
        ]
