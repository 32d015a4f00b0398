"""Chains of the shipped wrappers as one pass.

A chain that is nothing but shipped wrappers in the usual order (fixed sizes, polar
coordinates, actions in steps, flattening) need not be walked wrapper by wrapper: the compiled
kernel does all at once, from records to what the agent gets and from the agent's action to
controls. The ``racing`` view is made of records too, by :class:`RacingSight`. Every other chain is
run as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from stkzoo.kernel import kernel
from stkzoo.mdp.spaces import shows_ground
from stkzoo.wrappers.constant_size import ConstantSizedObservations
from stkzoo.wrappers.continuous_actions import OnlyContinuousActionsWrapper
from stkzoo.wrappers.discrete_actions import DiscreteActionsWrapper
from stkzoo.wrappers.flatten_multidiscrete import FlattenMultiDiscreteActions
from stkzoo.wrappers.flattener import FlattenerWrapper
from stkzoo.wrappers.polar import PolarObservations
from stkzoo.wrappers.racing.batched_view import RacingSight
from stkzoo.wrappers.racing.ground import GroundSight
from stkzoo.wrappers.racing.wrapper import RacingActions, RacingObservations

__all__ = ["fused_controls", "fused_view"]

#: (low, high, is whole, column, table or None) for each number under one key.
_Leaf = tuple[tuple[float, float, bool, int, Any], ...]


def fused_view(wrappers: Sequence[Any], base: Any) -> Any:
    """What shows at once what some wrappers make of a base observation.

    Args:
        wrappers: all wrappers, the innermost first.
        base: the base observation space.

    Returns:
        A ``kernel.View``, a :class:`RacingSight`, a :class:`GroundSight`, or ``None`` if none can
        do what the wrappers do.
    """
    if not isinstance(base, spaces.Dict) or "action" in base.spaces:
        return None
    if [type(wrapper) for wrapper in wrappers] == _RACING:
        return RacingSight()
    if kernel is None:
        return None
    if not wrappers and shows_ground(base):
        plain = {key: part for key, part in base.spaces.items() if not key.startswith("ground_")}
        return GroundSight(fused_view((), spaces.Dict(plain)))
    space: Any = base
    sizes: dict[str, int] = {}
    is_polar = is_flat = False
    for wrapper in wrappers:
        kind = type(wrapper)
        if is_flat and kind is not FlattenMultiDiscreteActions:
            return None
        if kind is ConstantSizedObservations and not sizes:
            sizes = {
                "items": wrapper.state_items,
                "karts": wrapper.state_karts,
                "paths": wrapper.state_paths,
            }
        elif kind is PolarObservations and not is_polar:
            is_polar = True
        elif kind is FlattenerWrapper and wrapper.flatten_observations and sizes:
            is_flat = True
        elif kind not in _ACTIONS_ONLY and not _leaves_observations(wrapper):
            return None
        if not is_flat:
            space = wrapper.observation_space
    names = _flat_names(wrappers) if is_flat else tuple(space.spaces)
    try:
        return kernel.View(names, **sizes, polar=is_polar, flat=is_flat)
    except ValueError:  # entries that the kernel does not know
        return None


_RACING = [RacingObservations, RacingActions]
_ACTIONS_ONLY = (OnlyContinuousActionsWrapper, DiscreteActionsWrapper, FlattenMultiDiscreteActions)


def _leaves_observations(wrapper: Any) -> bool:
    return type(wrapper) is FlattenerWrapper and not wrapper.flatten_observations


def _flat_names(wrappers: Sequence[Any]) -> tuple[str, ...]:
    flattener = next(w.observation_flattener for w in wrappers if type(w) is FlattenerWrapper)
    return (*flattener.continuous_keys, *flattener.discrete_keys)


def fused_controls(wrappers: Sequence[Any], base: Any, columns: Sequence[str]) -> Any:
    """The kernel's reader of the actions that some wrappers turn into base actions.

    Args:
        wrappers: all wrappers, the innermost first.
        base: the base action space, a ``Dict`` of single numbers.
        columns: the keys of ``base`` in the order of the controls' columns.

    Returns:
        A ``kernel.Controls``, or ``None`` if the kernel cannot do what the wrappers do.
    """
    if kernel is None or not all(_is_number(part) for part in base.spaces.values()):
        return None
    leaves: dict[str, _Leaf] = {
        key: (_entry(base[key], column),) for column, key in enumerate(columns)
    }
    is_flat = False
    for number, wrapper in enumerate(wrappers):
        kind = type(wrapper)
        if kind is FlattenMultiDiscreteActions:
            return _numbered(wrappers[: number + 1], columns) if is_flat else None
        if is_flat and kind not in (ConstantSizedObservations, PolarObservations):
            return None
        if kind is OnlyContinuousActionsWrapper:
            leaves = {key: leaves[key] for key in wrapper.action_space}
        elif kind is DiscreteActionsWrapper:
            for key in ("acceleration", "steer"):
                leaves[key] = _stepped(getattr(wrapper, f"d_{key}"), leaves[key][0][3])
        elif kind is FlattenerWrapper:
            leaves = _flattened(leaves, wrapper)
            is_flat = True
        elif kind not in (ConstantSizedObservations, PolarObservations):
            return None
    names = () if set(leaves) == {""} else tuple(leaves)
    return kernel.Controls(names, tuple(leaves.values()), len(columns))


def _is_number(part: spaces.Space[Any]) -> bool:
    return isinstance(part, spaces.Discrete) or (
        isinstance(part, spaces.Box) and part.shape == (1,) and part.dtype == np.float32
    )


def _entry(part: Any, column: int) -> tuple[float, float, bool, int, Any]:
    if isinstance(part, spaces.Discrete):
        return float(part.start), float(part.start + part.n - 1), True, column, None
    return float(part.low[0]), float(part.high[0]), False, column, None


def _stepped(discretizer: Any, column: int) -> _Leaf:
    table = discretizer.numbers(np.arange(discretizer.values)).astype(np.float32)
    return ((0.0, float(discretizer.values - 1), True, column, table),)


def _flattened(leaves: dict[str, _Leaf], wrapper: FlattenerWrapper) -> dict[str, _Leaf]:
    flattener = wrapper.action_flattener
    groups = {"continuous": flattener.continuous_keys, "discrete": flattener.discrete_keys}
    joined = {
        name: tuple(entry for key in keys for entry in leaves[key])
        for name, keys in groups.items()
        if keys
    }
    return joined if len(joined) > 1 else {"": next(iter(joined.values()))}


def _numbered(wrappers: Sequence[Any], columns: Sequence[str]) -> Any:
    """The reader of an action that is one number, by a table of all of them."""
    count = int(wrappers[-1].action_space.n)
    action: Any = np.arange(count)
    for wrapper in reversed(wrappers):
        if type(wrapper) not in (ConstantSizedObservations, PolarObservations):
            action = wrapper.action(action)
    parts = [np.reshape(action[key], (count, 1)) for key in columns]
    table = np.concatenate(parts, axis=1, dtype=np.float32)
    assert kernel is not None  # noqa: S101 - fused_controls has looked
    return kernel.Controls((), (((0.0, count - 1.0, True, 0, table),),), len(columns))
