"""The twin of ``game_stepper.c``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS, HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot

Records = npt.NDArray[np.void]

#: The first controls are numbers, the others buttons.
_NUM_ANALOGUE = 2
_ZERO_CONTROL = (0.0,) * len(CONTROLS)


class GameStepper:
    """A race of the engine, stepped, and read attribute by attribute.

    Args:
        race: a ``pystk2.Race`` that has started.
        world: its ``pystk2.WorldState``.
        actions: a ``pystk2.Action`` for each player kart in grid order.
        controls: the names of an action's parts.
        attributes: the fields of a kart that are no part of the engine's own block of bytes.
        phases: our numbers of the engine's phases.
        last_phase: the number of all other phases.
        reporting: the karts whose driver's controls are read.
        plans: where all else lies in that block (:func:`stkzoo.engine.reader.block_plans`).
    """

    def __init__(
        self,
        race: Any,
        world: Any,
        actions: list[Any],
        controls: tuple[str, ...],
        attributes: tuple[str, ...],
        phases: Mapping[Any, int],
        last_phase: int,
        reporting: Sequence[int],
        plans: tuple[Any, ...] | None,
    ) -> None:
        del attributes, plans  # all is read by attribute
        self._race, self._world, self._actions = race, world, actions
        self._controls, self._reporting = controls, reporting
        self._phases, self._last_phase = phases, last_phase

    def step(self, controls: bytes | npt.NDArray[np.float32]) -> bytes:
        """Advances the game by one step.

        Args:
            controls: ``(P, 7)`` float32, or its bytes: a row for each player kart.

        Returns:
            The moment after it, as the bytes of a :class:`~stkzoo.engine.snapshot.Snapshot`.
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
        """The present moment."""
        world = self._world
        karts = _records(KART_DTYPE, world.karts, _kart_record)
        items = _records(ITEM_DTYPE, world.items, _item_record)
        for row in self._reporting:
            action = self._race.get_kart_action(row)
            karts[row]["control"] = [float(getattr(action, name)) for name in self._controls]
        phase = self._phases.get(world.phase, self._last_phase)
        header = np.array(
            [(world.time, world.aux_ticks, phase, len(karts), len(items), is_running)],
            HEADER_DTYPE,
        )
        return Snapshot.of(header[0], karts, items).data


def _records(
    dtype: np.dtype[np.void], objects: Iterable[Any], record: Callable[[Any], tuple[Any, ...]]
) -> Records:
    return np.array([record(thing) for thing in objects], dtype)


def _item_record(item: Any) -> tuple[Any, ...]:
    """The fields of ``ITEM_DTYPE`` in its order."""
    return item.location, item.size, item.type.value, item.id


def _kart_record(kart: Any) -> tuple[Any, ...]:
    """The fields of ``KART_DTYPE`` in its order."""
    powerup, attachment = kart.powerup, kart.attachment
    return (
        kart.location,
        kart.rotation,
        kart.front,
        kart.velocity,
        kart.velocity_lc,
        kart.angular_velocity,
        kart.size,
        kart.speed,
        kart.max_steer_angle,
        kart.wheel_base,
        kart.energy,
        kart.skeed_factor,
        kart.shield_time,
        attachment.time_left,
        kart.distance_down_track,
        kart.overall_distance,
        kart.finish_time,
        kart.lap_time,
        kart.node,
        kart.position,
        kart.finished_laps,
        powerup.type.value,
        powerup.num,
        attachment.type.value,
        kart.has_finished_race,
        kart.race_result,
        kart.jumping,
        kart.is_on_road,
        _ZERO_CONTROL,
    )
