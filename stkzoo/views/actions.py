"""Actions as they come from users, checked and brought into batch form.

The *batch form* of a value has the agents as the leading axis: ``(A,)`` for ``Discrete`` and
``Text``, ``(A, *shape)`` for ``Box`` and its like, a dict of these for ``Dict``. The *single form*
is Gymnasium's own: ``int``, ``str``, array, tuple, dict.

The form is taken kindly: a bare number for an array of one entry, lists, Python's and
numpy's numbers, ``bool`` for a choice, whole ``float`` numbers for whole ones. The value
is taken strictly: nothing infinite, undefined, out of range or of another shape.
"""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.errors import ActionError

#: A number may miss a bound of its ``Box`` by this much (rounding); it is then clipped.
BOUND_TOLERANCE = 1e-6


def read_actions(
    space: spaces.Space[Any], actions: Sequence[object], agents: Sequence[str], name: str = "action"
) -> Any:
    """Checks actions of agents that share a space; returns them in batch form.

    Args:
        space: the space of each action. Kinds other than ``Dict``, ``Box``, ``Discrete``
            and ``MultiDiscrete`` are left to their own ``contains``.
        actions: one action for each agent.
        agents: the agents' ids, for the message.
        name: what the values are called in the message.

    Returns:
        For ``Dict`` a dict of arrays, for the other three an array, each with the agents
        as the leading axis and the space's dtype; else the actions in a list. Nothing
        shares memory with the input.

    Raises:
        ActionError: an action is not in the space; the text names agent, key and value.
    """
    batch = _batch(space, actions)
    if batch is not None:
        return batch
    for agent, action in zip(agents, actions, strict=True):
        if _batch(space, [action]) is None:
            raise ActionError(_complaint(space, action, agent, name), agent)
    singles = [_batch(space, [action]) for action in actions]
    return _joined(space, singles)


def _joined(space: spaces.Space[Any], batches: list[Any]) -> Any:
    if isinstance(space, spaces.Dict):
        parts = space.spaces.items()
        return {key: _joined(part, [batch[key] for batch in batches]) for key, part in parts}
    if isinstance(batches[0], list):
        return [single for batch in batches for single in batch]
    return np.concatenate(batches)


def _batch(space: spaces.Space[Any], values: Sequence[Any]) -> Any:
    """The values in batch form, or ``None`` if they are not all in the space."""
    if isinstance(space, spaces.Dict):
        return _dict_batch(space, values)
    if isinstance(space, (spaces.Box, spaces.Discrete, spaces.MultiDiscrete)):
        return _array_batch(space, values)
    return list(values) if all(space.contains(value) for value in values) else None


def _dict_batch(space: spaces.Dict, values: Sequence[Any]) -> dict[str, Any] | None:
    keys = space.spaces.keys()
    if not all(isinstance(value, Mapping) and value.keys() == keys for value in values):
        return None
    batch = {}
    for key, part in space.spaces.items():
        column = _batch(part, [value[key] for value in values])
        if column is None:
            return None
        batch[key] = column
    return batch


def _array_batch(
    space: spaces.Box | spaces.Discrete | spaces.MultiDiscrete, values: Sequence[Any]
) -> npt.NDArray[Any] | None:
    try:
        array = np.asarray(values)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return None
    if array.dtype.kind not in "biuf":
        return None
    shape = (len(values), *(space.shape or ()))
    if array.shape != shape:
        if array.size != len(values) or np.prod(shape) != len(values):
            return None
        array = array.reshape(shape)
    low, high = _bounds(space)
    if _is_whole(space):
        if array.dtype.kind == "f" and not np.all(array == np.floor(array)):
            return None
        is_inside = bool(np.all((array >= low) & (array <= high)))
    else:
        above, below = low - BOUND_TOLERANCE, high + BOUND_TOLERANCE
        is_inside = bool(np.all((array >= above) & (array <= below) & np.isfinite(array)))
    return np.clip(array, low, high).astype(space.dtype) if is_inside else None


def _bounds(space: spaces.Box | spaces.Discrete | spaces.MultiDiscrete) -> tuple[Any, Any]:
    """Lowest and highest value of each entry, both included."""
    if isinstance(space, spaces.Box):
        return space.low, space.high
    count = space.n if isinstance(space, spaces.Discrete) else space.nvec
    return space.start, space.start + count - 1


def _is_whole(space: spaces.Space[Any]) -> bool:
    return not isinstance(space, spaces.Box) or space.dtype.kind in "biu"


def _complaint(space: spaces.Space[Any], value: Any, agent: str, name: str) -> str:
    """What is wrong with an action that is not in its space."""
    if isinstance(space, spaces.Dict):
        if not isinstance(value, Mapping):
            return _sentence(agent, name, value, f"a dict with the keys {', '.join(space.spaces)}")
        missing = [key for key in space.spaces if key not in value]
        unknown = [str(key) for key in value if key not in space.spaces]
        if missing or unknown:
            faults = [f"lacks {', '.join(missing)}"] if missing else []
            faults += [f"has unknown keys {', '.join(unknown)}"] if unknown else []
            return (
                f"the {name} of agent {agent!r} {' and '.join(faults)}; expected exactly the "
                f"keys {', '.join(space.spaces)}. Send all of them."
            )
        for key, part in space.spaces.items():
            if _batch(part, [value[key]]) is None:
                return _complaint(part, value[key], agent, f"{name}[{key!r}]")
    return _sentence(agent, name, value, _expectation(space))


def _sentence(agent: str, name: str, value: object, expected: str) -> str:
    return (
        f"the {name} of agent {agent!r} is {reprlib.repr(value)}; expected {expected}. "
        "env.action_space(agent).sample() shows the form."
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
    return f"a {noun} {limits}" if count == 1 else f"{space.shape} {noun}s {limits}"


def split(space: spaces.Space[Any], batch: Any) -> list[Any]:
    """The single forms of a batch, which share no memory with it.

    Args:
        space: the space of each single form.
        batch: values in batch form.

    Returns:
        One value for each row.
    """
    if isinstance(space, spaces.Dict):
        columns = [split(part, batch[key]) for key, part in space.spaces.items()]
        keys = tuple(space.spaces)
        return [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    if isinstance(space, (spaces.Discrete, spaces.Text)):
        values: list[Any] = np.asarray(batch).tolist()
        return values
    if isinstance(space, spaces.Sequence):
        return [tuple(row) for row in np.array(batch)]
    return list(np.array(batch)) if isinstance(batch, np.ndarray) else list(batch)
