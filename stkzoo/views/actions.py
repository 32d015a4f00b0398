"""Checks users' actions and converts them to Gymnasium's form.

The kernel reads actions in usual forms (``stkzoo/kernel/action_reader.c``). This module converts
all others, and explains what is wrong with an action.

The accepted forms are lenient: a number in place of an array of one entry, lists, Python and numpy
numbers, ``bool`` for a choice, whole ``float`` values for integers. The values are strict:
infinite, NaN and out-of-range values and other shapes are rejected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo._checks import shortened
from stkzoo.errors import ActionError

#: A number may exceed a bound of its ``Box`` by this much, because of rounding; it is clipped.
BOUND_TOLERANCE = 1e-6
#: Unknown keys that an error names, and the most characters of one.
_MAX_KEYS, _MAX_KEY = 8, 40
#: Most entries of a list that an error reads.
_MAX_SHOWN = 1000


def read_action(space: spaces.Space[Any], action: object, agent: str, name: str = "action") -> Any:
    """Checks an agent's action and converts it to Gymnasium's form.

    Args:
        space: space of the action. Spaces other than ``Dict``, ``Box``, ``Discrete`` and
            ``MultiDiscrete`` are checked with their own ``contains``.
        action: the action.
        agent: the agent's id, for the error message.
        name: name of the value in the error message.

    Returns:
        The action with the space's dtype: an ``int`` for ``Discrete``, an array for ``Box`` and
            ``MultiDiscrete``, a dict of these for ``Dict``. It shares no memory with the input.

    Raises:
        ActionError: the action is not in the space. The message names agent, key and value.
    """
    value = _value(space, action)
    if value is None:
        raise ActionError(_complaint(space, action, agent, name), agent)
    return value


def fit_action(space: spaces.Space[Any], action: object) -> Any:
    """Returns an action as pystk2-gymnasium reads it, which accepts any finite numbers.

    Unknown keys are left out. Numbers are clipped to their bounds, whole ones after rounding toward
    zero: for a button, 0.63 and -1 are 0, and 2 is 1. Values of other forms are kept.

    Args:
        space: space of the action.
        action: the action.
    """
    if isinstance(space, spaces.Dict) and isinstance(action, Mapping):
        return {k: fit_action(part, action[k]) for k, part in space.spaces.items() if k in action}
    if not isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete)):
        return action
    try:
        array = np.asarray(action, np.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return action
    low, high = _bounds(space)
    if array.size != len(low) or not np.isfinite(array).all():
        return action
    numbers = np.trunc(array) if _is_whole(space) else array
    return np.clip(numbers.reshape(-1), low, high).reshape(array.shape)


def _value(space: spaces.Space[Any], action: Any) -> Any:
    """Returns the action in Gymnasium's form, or ``None`` if it is not in the space."""
    if isinstance(space, spaces.Dict):
        if not isinstance(action, Mapping) or action.keys() != space.spaces.keys():
            return None
        values = {key: _value(part, action[key]) for key, part in space.spaces.items()}
        return None if any(value is None for value in values.values()) else values
    if isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete)):
        return _number_or_array(space, action)
    return action if space.contains(action) else None


def _number_or_array(
    space: spaces.Box | spaces.Discrete | spaces.MultiDiscrete, action: Any
) -> Any:
    shape = space.shape or ()
    if not _is_small(action, max(1, *shape or (1,))):
        return None
    try:
        array = np.asarray(action)
    except Exception:  # noqa: BLE001 - of the action's own code
        return None
    if array.dtype.kind not in "biuf":
        return None
    if array.shape != shape and not array.size == math.prod(shape) == 1:
        return None
    # Python's own numbers: for a few of them, several times as fast as numpy's functions.
    entries = [*zip(array.reshape(-1).tolist(), *_bounds(space), strict=True)]
    is_whole = _is_whole(space)
    slack = 0 if is_whole else BOUND_TOLERANCE
    if not all(
        low - slack <= number <= high + slack
        and math.isfinite(number)
        and (number == number // 1 or not is_whole)
        for number, low, high in entries
    ):
        return None
    clipped = [min(max(number, low), high) for number, low, high in entries]
    if isinstance(space, spaces.Discrete):
        return int(clipped[0])
    return np.array(clipped, space.dtype).reshape(shape)


def _is_small(action: Any, length: int) -> bool:
    """Whether no list in an action is longer than its space, and none has text in it.

    Of a list of texts, numpy would make an array in which each is as wide as the longest.
    """
    if not isinstance(action, (list, tuple)):
        return not isinstance(action, (str, bytes))
    return len(action) <= length and all(_is_small(item, length) for item in action)


def _bounds(
    space: spaces.Box | spaces.Discrete | spaces.MultiDiscrete,
) -> tuple[list[Any], list[Any]]:
    """Returns the lowest and the highest value of each entry, both inclusive."""
    if isinstance(space, spaces.Box):
        return space.low.reshape(-1).tolist(), space.high.reshape(-1).tolist()
    if isinstance(space, spaces.Discrete):
        low = int(space.start)
        return [low], [low + int(space.n) - 1]
    return space.start.reshape(-1).tolist(), (space.start + space.nvec - 1).reshape(-1).tolist()


def _is_whole(space: spaces.Space[Any]) -> bool:
    return not isinstance(space, spaces.Box) or space.dtype.kind in "biu"


def _complaint(space: spaces.Space[Any], value: Any, agent: str, name: str) -> str:
    """Describes why an action is not in its space."""
    if isinstance(space, spaces.Dict):
        if not isinstance(value, Mapping):
            return _sentence(agent, name, value, f"a dict with the keys {', '.join(space.spaces)}")
        missing = [key for key in space.spaces if key not in value]
        unknown = [str(key)[:_MAX_KEY] for key in value if key not in space.spaces][:_MAX_KEYS]
        if missing or unknown:
            faults = [f"lacks {', '.join(missing)}"] if missing else []
            faults += [f"has unknown keys {', '.join(unknown)}"] if unknown else []
            return (
                f"the {name} of agent {agent!r} {' and '.join(faults)}; expected exactly the "
                f"keys {', '.join(space.spaces)}."
            )
        for key, part in space.spaces.items():
            if _value(part, value[key]) is None:
                return _complaint(part, value[key], agent, f"{name}[{key!r}]")
    if _is_small(value, _MAX_SHOWN):
        try:
            np.asarray(value)
        except Exception as error:  # noqa: BLE001 - of the action's own code
            text = f"the {name} of agent {agent!r} is {shortened(value, 40)}"
            return f"{text}; numpy says: {str(error)[:120]}"
    return _sentence(agent, name, value, _expectation(space))


def _sentence(agent: str, name: str, value: object, expected: str) -> str:
    text, shape = shortened(value, 100), getattr(value, "shape", ())
    if shape and "shape" not in text:
        text += f" of shape {tuple(shape)}"
    return (
        f"the {name} of agent {agent!r} is {text}; expected {expected}. "
        "A sample of the action space shows the form."
    )


def _expectation(space: spaces.Space[Any]) -> str:
    if not isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete)):
        return f"a value of {space}"
    noun = "whole number" if _is_whole(space) else "number"
    low, high = (np.unique(bound) for bound in _bounds(space))
    limits = (
        f"from {low[0]} to {high[0]}"
        if low.size == high.size == 1
        else f"from {_bounds(space)[0]} to {_bounds(space)[1]}"
    )
    count = int(np.prod(space.shape or ()))
    return f"a {noun} {limits}" if count == 1 else f"{noun}s of shape {space.shape} {limits}"
