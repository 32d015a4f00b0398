"""Converts the same driving to the actions of each contender.

A row of controls has seven numbers for a kart: acceleration, steer, then five buttons.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

#: Values of the views with discrete actions. Other views use the same values, so that all
#: contenders drive identically.
ACCELERATIONS = np.linspace(0.0, 1.0, 5)
STEERS = np.linspace(-1.0, 1.0, 7)
FULL_THROTTLE = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
_BUTTONS = ("brake", "drift", "fire", "nitro", "rescue")

#: Driving style whose rows contain a steering angle [rad] and a speed [m/s].
PHYSICAL = "physical"
_STYLES = {
    "flattened_continuous_actions": "pedal and wheel",
    "box_continuous": "pedal and wheel",
    "racing": "choices",
    "contest": "choices",
    "control": PHYSICAL,
    "flattened_control": PHYSICAL,
}


def driving_style(view: str) -> str:
    """Returns the driving style of a view; views of one style can drive exactly the same race.

    Args:
        view: name of the view.

    Returns:
        ``"grid"``: discrete acceleration and steering, and all buttons; ``"pedal and wheel"``: no
        buttons; ``"choices"``: those of the views ``racing`` and ``contest``; or
        :data:`PHYSICAL`.
    """
    return _STYLES.get(view, "grid")


def controls_of(style: str, action: Mapping[str, Any]) -> list[float]:
    """Returns the nearest row that a driving style can express.

    Args:
        style: see :func:`driving_style`.
        action: action of the view ``full``; with :data:`PHYSICAL`, of
            :class:`~stkzoo.wrappers.control.ControlWrapper` around ``full``.
    """
    if style == PHYSICAL:
        return [*map(float, action["control"]), 0.0, 0.0, 0.0, 0.0, 0.0]
    keys = ("acceleration", "steer", *_BUTTONS)
    row = np.array([float(np.ravel(action[key])[0]) for key in keys])
    if style == "choices":
        from stkzoo.wrappers.racing import controls_of_choices

        fitted: list[float] = controls_of_choices(_choices(row)).tolist()
        return fitted
    pedal = ACCELERATIONS[np.abs(ACCELERATIONS - row[0]).argmin()]
    wheel = STEERS[np.abs(STEERS - row[1]).argmin()]
    buttons = row[2:] > 0 if style == "grid" else np.zeros(5)
    return [float(pedal), float(wheel), *map(float, buttons)]


def to_action(view: str, row: FloatArray) -> Any:
    """Returns a kart's action in a view.

    Args:
        view: name of the view.
        row: ``(7,)``, a row of controls in the view's :func:`driving_style`.
    """
    pair = np.array(row[:2], np.float32)
    if view == "control":
        return {"control": pair}
    if view == "flattened_control":
        from stkzoo.wrappers.control import CarAction

        space = CarAction().space
        return (pair - space.low) / (space.high - space.low) * np.float32(2) - np.float32(1)
    if driving_style(view) == "choices":
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


def _choices(row: FloatArray) -> npt.NDArray[np.int64]:
    from stkzoo.wrappers.racing import choices_of_action

    return choices_of_action(_full(row))


def _full(row: FloatArray) -> dict[str, Any]:
    return {
        "acceleration": np.array([row[0]], np.float32),
        "steer": np.array([row[1]], np.float32),
        **{button: int(value) for button, value in zip(_BUTTONS, row[2:], strict=True)},
    }
