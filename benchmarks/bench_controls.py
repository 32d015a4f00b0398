"""Converts the same driving to the actions of each contender."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

__all__ = [
    "ACCELERATIONS",
    "PHYSICAL",
    "STEERS",
    "Controls",
    "RandomControls",
    "RecordedControls",
    "controls_of",
    "driving_style",
    "to_action",
]

FloatArray = npt.NDArray[np.float64]

#: Values of the views with discrete actions. Other views use the same values, so that all
#: contenders drive identically.
ACCELERATIONS = np.linspace(0.0, 1.0, 5)
STEERS = np.linspace(-1.0, 1.0, 7)

_BUTTONS = ("brake", "drift", "fire", "nitro", "rescue")
_PRESSED = (0.03, 0.15, 0.1, 0.2, 0.005)
#: Number of steps for which random controls are held.
_HOLD_STEPS = 4

#: Driving style whose rows contain a steering angle [rad] and a speed [m/s].
PHYSICAL = "physical"
_STYLES = {
    "flattened_continuous_actions": "pedal and wheel",
    "box_continuous": "pedal and wheel",
    "racing": "choices",
    "control": PHYSICAL,
    "flattened_control": PHYSICAL,
}


def driving_style(view: str) -> str:
    """Returns the driving style of a view; views of one style can drive exactly the same race.

    Args:
        view: name of the view.

    Returns:
        ``"grid"``: discrete acceleration and steering, and all buttons; ``"pedal and wheel"``: no
        buttons; ``"choices"``: those of the view ``racing``; or :data:`PHYSICAL`.
    """
    return _STYLES.get(view, "grid")


class Controls(Protocol):
    """A source of controls for the karts of a race."""

    def next(self) -> FloatArray:
        """Returns ``(K, 7)`` for the next step: acceleration, steer, then five buttons."""


class RecordedControls:
    """Recorded controls, repeated from the start when they end.

    Args:
        rows: ``(N, K, 7)``, N steps of K karts.
    """

    def __init__(self, rows: npt.ArrayLike) -> None:
        self._rows = np.array(rows, np.float64)
        self._step = 0

    def next(self) -> FloatArray:
        """See :meth:`Controls.next`."""
        row: FloatArray = self._rows[self._step % len(self._rows)]
        self._step += 1
        return row


class RandomControls:
    """Seeded random controls of all karts: mostly full throttle, random steering, few buttons.

    Karts soon get stuck at walls, where a step costs the engine more. Do not use these controls to
    compare steps.

    Args:
        num_kart: number of karts.
        view: view whose driving style the controls have.
        seed: seed of the random controls.
    """

    def __init__(self, num_kart: int, view: str, seed: int = 0) -> None:
        self._num_kart = num_kart
        self._style = driving_style(view)
        self._random = np.random.default_rng(seed)
        self._held = np.zeros((num_kart, 7))
        self._step = 0

    def next(self) -> FloatArray:
        """See :meth:`Controls.next`."""
        if self._step % _HOLD_STEPS == 0:
            self._held = np.array([_fit(self._style, row) for row in self._draw()])
        self._step += 1
        return self._held

    def _draw(self) -> FloatArray:
        random, size = self._random, self._num_kart
        throttle = ACCELERATIONS[random.choice(5, size, p=(0.05, 0.0, 0.05, 0.1, 0.8))]
        steer = STEERS[random.choice(7, size, p=(0.05, 0.1, 0.15, 0.4, 0.15, 0.1, 0.05))]
        buttons = random.random((size, len(_BUTTONS))) < _PRESSED
        return np.column_stack([throttle, steer, buttons])


def controls_of(style: str, action: Mapping[str, Any]) -> list[float]:
    """Returns the row of :meth:`Controls.next` nearest to an action of the view ``full``.

    Args:
        style: see :func:`driving_style`; with :data:`PHYSICAL`, an action of a
            :class:`~stkzoo.wrappers.control.ControlView` of ``full``.
        action: the action.
    """
    if style == PHYSICAL:
        return [*map(float, action["control"]), 0.0, 0.0, 0.0, 0.0, 0.0]
    keys = ("acceleration", "steer", *_BUTTONS)
    return _fit(style, np.array([float(np.ravel(action[key])[0]) for key in keys]))


def _fit(style: str, row: FloatArray) -> list[float]:
    """Returns the nearest row that a driving style can express."""
    if style == PHYSICAL:
        return [0.3 * row[1], 20.0 * row[0], 0.0, 0.0, 0.0, 0.0, 0.0]
    if style == "choices":
        from stkzoo.wrappers.racing import controls_of_choices

        fitted: list[float] = controls_of_choices(_choices(row)).tolist()
        return fitted
    pedal = ACCELERATIONS[np.abs(ACCELERATIONS - row[0]).argmin()]
    wheel = STEERS[np.abs(STEERS - row[1]).argmin()]
    buttons = row[2:] > 0 if style == "grid" else np.zeros(5)
    return [float(pedal), float(wheel), *map(float, buttons)]


def _choices(row: FloatArray) -> npt.NDArray[np.int64]:
    from stkzoo.wrappers.racing import choices_of_action

    return choices_of_action(_full(row))


def _full(row: FloatArray) -> dict[str, Any]:
    return {
        "acceleration": np.array([row[0]], np.float32),
        "steer": np.array([row[1]], np.float32),
        **{button: int(value) for button, value in zip(_BUTTONS, row[2:], strict=True)},
    }


def to_action(view: str, row: FloatArray) -> Any:
    """Returns a kart's action in a view.

    Args:
        view: name of the view.
        row: ``(7,)``, a row of :meth:`Controls.next` in the view's :func:`driving_style`.
    """
    pair = np.array(row[:2], np.float32)
    if view == "control":
        return {"control": pair}
    if view == "flattened_control":
        from stkzoo.wrappers.control import CarAction

        space = CarAction().space
        return (pair - space.low) / (space.high - space.low) * np.float32(2) - np.float32(1)
    if view == "racing":
        return _choices(row)
    if view == "flattened":
        return {"continuous": pair, "discrete": np.array(row[2:], np.int64)}
    if view in ("flattened_continuous_actions", "box_continuous"):
        return pair
    if view in ("flattened_multidiscrete", "flattened_discrete", "box_discrete", "masked_discrete"):
        steps = np.abs(ACCELERATIONS - row[0]).argmin(), np.abs(STEERS - row[1]).argmin()
        choices = np.array([steps[0], *row[2:], steps[1]], np.int64)
        if view == "flattened_multidiscrete":
            return choices
        return int(np.ravel_multi_index(tuple(choices[::-1]), (7, 2, 2, 2, 2, 2, 5)))
    return _full(np.asarray(row))
