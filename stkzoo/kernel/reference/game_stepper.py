"""The reference implementation of ``game_stepper.c``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot

#: Number of analog controls, which come first; the others are buttons.
_NUM_ANALOGUE = 2
_ZERO_CONTROL = (0.0,) * len(CONTROLS)

#: The engine's names of record fields, where they differ from the field's name.
_ATTRIBUTES = {
    "attachment_time_left": "attachment.time_left",
    "attachment_type": "attachment.type.value",
    "powerup_num": "powerup.num",
    "powerup_type": "powerup.type.value",
    "type": "type.value",
}
#: Read all fields of a record in order, except for a kart's last field, its control.
_item_of, _kart_of = (
    attrgetter(*(_ATTRIBUTES.get(name, name) for name in names))
    for names in (ITEM_DTYPE.names or (), (KART_DTYPE.names or ())[:-1])
)


class GameStepper:
    """Steps a race of the engine, and reads it attribute by attribute.

    Args:
        race: a ``pystk2.Race`` that has started.
        world: its ``pystk2.WorldState``.
        actions: a ``pystk2.Action`` for each player kart, in grid order.
        controls: names of the controls, which are attributes of an action.
        phases: number of each of the engine's phases.
        last_phase: number of all other phases.
        reporting: karts whose driver's controls are read.
    """

    def __init__(
        self,
        race: Any,
        world: Any,
        actions: list[Any],
        controls: tuple[str, ...],
        phases: Mapping[Any, int],
        last_phase: int,
        reporting: Sequence[int],
    ) -> None:
        self._race, self._world, self._actions = race, world, actions
        self._controls, self._reporting = controls, reporting
        self._phases, self._last_phase = phases, last_phase

    def step(self, controls: bytes | npt.NDArray[np.float32]) -> bytes:
        """Advances the game by one step.

        Args:
            controls: ``(P, 7)`` float32, or its bytes: a row for each player kart.

        Returns:
            The bytes of a :class:`~stkzoo.engine.snapshot.Snapshot` after the step.
        """
        numbers = np.frombuffer(controls, np.float32)
        if numbers.size != len(self._actions) * len(self._controls):
            raise ValueError(f"{numbers.nbytes} bytes of controls")
        rows = numbers.reshape(len(self._actions), len(self._controls)).tolist()
        for action, row in zip(self._actions, rows, strict=True):
            for column, (name, value) in enumerate(zip(self._controls, row, strict=True)):
                setattr(action, name, value if column < _NUM_ANALOGUE else value > 0)
        is_running = self._race.step(self._actions) if self._actions else self._race.step()
        self._world.update()
        return self.read(is_running)

    def read(self, is_running: bool) -> bytes:
        """Returns the bytes of a snapshot of the current state."""
        world = self._world
        karts = np.array([(*_kart_of(kart), _ZERO_CONTROL) for kart in world.karts], KART_DTYPE)
        items = np.array([_item_of(item) for item in world.items], ITEM_DTYPE)
        for row in self._reporting:
            action = self._race.get_kart_action(row)
            karts[row]["control"] = [float(getattr(action, name)) for name in self._controls]
        phase = self._phases.get(world.phase, self._last_phase)
        header = np.array(
            [(world.time, world.aux_ticks, phase, len(karts), len(items), is_running)],
            HEADER_DTYPE,
        )
        return Snapshot.of(header[0], karts, items).data
