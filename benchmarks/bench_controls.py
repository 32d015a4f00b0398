"""The same driving for all contenders, whatever form of action each of them takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

__all__ = [
    "ACCELERATIONS",
    "STEERS",
    "Controls",
    "RandomControls",
    "RecordedControls",
    "on_grid",
    "to_action",
]

#: The steps of the views with discrete actions; every view is driven on this grid, so that
#: all contenders can do the same.
ACCELERATIONS = np.linspace(0.0, 1.0, 5)
STEERS = np.linspace(-1.0, 1.0, 7)

_BUTTONS = ("brake", "drift", "fire", "nitro", "rescue")
_PRESSED = (0.03, 0.15, 0.1, 0.2, 0.005)
#: A draw is held for so many steps.
_HOLD_STEPS = 4


class Controls(Protocol):
    """Where a race's driving comes from."""

    def next(self) -> npt.NDArray[np.int64]:
        """``(K, 7)`` for the next step: throttle and steering step, then five buttons."""


class RecordedControls:
    """Driving that was recorded before, again from its start when it is over.

    Args:
        rows: ``(N, K, 7)`` whole numbers, for N steps of K karts.
    """

    def __init__(self, rows: npt.ArrayLike) -> None:
        self._rows = np.array(rows, np.int64)
        self._step = 0

    def next(self) -> npt.NDArray[np.int64]:
        """See :meth:`Controls.next`."""
        row: npt.NDArray[np.int64] = self._rows[self._step % len(self._rows)]
        self._step += 1
        return row


class RandomControls:
    """Seeded driving of all karts: mostly full throttle, wavering wheel, some of the rest.

    Such karts soon stand at walls, where a step costs the engine more: good enough where
    steps are not compared.

    Args:
        num_kart: number of karts.
        seed: of the stream.
    """

    def __init__(self, num_kart: int, seed: int = 0) -> None:
        self._num_kart = num_kart
        self._random = np.random.default_rng(seed)
        self._held = np.zeros((num_kart, 7), np.int64)
        self._step = 0

    def next(self) -> npt.NDArray[np.int64]:
        """See :meth:`Controls.next`."""
        if self._step % _HOLD_STEPS == 0:
            self._held = self._draw()
        self._step += 1
        return self._held

    def _draw(self) -> npt.NDArray[np.int64]:
        random, size = self._random, self._num_kart
        throttle = random.choice(5, size, p=(0.05, 0.0, 0.05, 0.1, 0.8))
        steer = random.choice(7, size, p=(0.05, 0.1, 0.15, 0.4, 0.15, 0.1, 0.05))
        buttons = random.random((size, len(_BUTTONS))) < _PRESSED
        return np.column_stack([throttle, steer, buttons]).astype(np.int64)


def on_grid(action: Mapping[str, Any]) -> list[int]:
    """The nearest control, as a row of :meth:`Controls.next`, to an action of ``full``."""
    return [
        int(np.abs(ACCELERATIONS - np.ravel(action["acceleration"])[0]).argmin()),
        int(np.abs(STEERS - np.ravel(action["steer"])[0]).argmin()),
        *(int(np.ravel(action[button])[0] > 0) for button in _BUTTONS),
    ]


def to_action(view: str, control: Sequence[int] | npt.NDArray[np.int64]) -> Any:
    """One kart's action in the form of a view.

    Args:
        view: ``full``, ``simple``, ``flattened`` or ``flattened_discrete``.
        control: ``(7,)``, a row of :meth:`Controls.next`.
    """
    throttle, steer, *buttons = map(int, control)
    if view == "flattened_discrete":
        brake, drift, fire, nitro, rescue = buttons
        number = 0
        choices = [throttle, brake, drift, fire, nitro, rescue, steer]
        for choice, count in zip(reversed(choices), (7, 2, 2, 2, 2, 2, 5), strict=True):
            number = number * count + choice
        return number
    numbers = ACCELERATIONS[throttle], STEERS[steer]
    if view == "flattened":
        return {
            "continuous": np.array(numbers, np.float32),
            "discrete": np.array(buttons, np.int64),
        }
    return {
        "acceleration": np.array([numbers[0]], np.float32),
        "steer": np.array([numbers[1]], np.float32),
        **dict(zip(_BUTTONS, buttons, strict=True)),
    }
