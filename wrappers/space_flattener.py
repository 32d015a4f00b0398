"""One vector of numbers and one of choices for a dict of both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from stkzoo.errors import ConfigError

__all__ = ["SpaceFlattener"]

Number = TypeVar("Number", np.float32, np.int64)


class _Part(NamedTuple):
    """One entry of the space: its key, shape and number of values."""

    key: str
    shape: tuple[int, ...]
    size: int


class SpaceFlattener:
    """Flattens the entries of a ``Dict`` space, in the order of their keys.

    ``Box`` entries go to ``"continuous"``, ``Discrete`` and ``MultiDiscrete`` entries to
    ``"discrete"``. A space with entries of one sort only gives the plain ``Box`` or
    ``MultiDiscrete``. ``Text`` entries and a game AI's ``action`` are left out.

    Attributes:
        space: the flattened space.
        continuous_keys: the keys of the ``Box`` entries, sorted.
        discrete_keys: the keys of the other entries, sorted.
        only_continuous: whether ``space`` is a plain ``Box``.
        only_discrete: whether ``space`` is a plain ``MultiDiscrete``.

    Args:
        space: the space to flatten.

    Raises:
        ConfigError: an entry of another kind, or no entry at all.
    """

    def __init__(self, space: spaces.Dict) -> None:
        self._boxes: dict[str, spaces.Box[Any]] = {}
        self._choices: dict[str, spaces.Discrete | spaces.MultiDiscrete] = {}
        for key, part in sorted(space.spaces.items()):
            if key == "action" or isinstance(part, spaces.Text):
                continue
            if isinstance(part, spaces.Box):
                self._boxes[key] = part
            elif isinstance(part, (spaces.Discrete, spaces.MultiDiscrete)):
                self._choices[key] = part
            else:
                raise ConfigError(_cannot_flatten(key, part))
        if not self._boxes and not self._choices:
            raise ConfigError(f"nothing to flatten in {space!r}; expected numbers or choices.")
        self.continuous_keys = list(self._boxes)
        self.discrete_keys = list(self._choices)
        self.only_continuous = not self._choices
        self.only_discrete = not self._boxes
        self.space = self._flat_space()
        self._box_parts = _parts(self._boxes)
        self._choice_parts = _parts(self._choices)

    def _flat_space(self) -> spaces.Space[Any]:
        if self.only_continuous:
            return self._continuous_space()
        if self.only_discrete:
            return self._discrete_space()
        return spaces.Dict(
            {"continuous": self._continuous_space(), "discrete": self._discrete_space()}
        )

    def _continuous_space(self) -> spaces.Box:
        boxes = self._boxes.values()
        low = np.concatenate([box.low.ravel() for box in boxes]).astype(np.float32)
        high = np.concatenate([box.high.ravel() for box in boxes]).astype(np.float32)
        return spaces.Box(low, high, dtype=np.float32)

    def _discrete_space(self) -> spaces.MultiDiscrete:
        counts: list[int] = []
        starts: list[int] = []
        for part in self._choices.values():
            counts.extend(np.ravel(part.n if isinstance(part, spaces.Discrete) else part.nvec))
            starts.extend(np.ravel(part.start))
        return spaces.MultiDiscrete(counts, dtype=np.int64, start=starts)

    def continuous(self, value: Mapping[str, Any]) -> NDArray[np.float32]:
        """The numbers of a value of the space, ``(..., n)`` float32."""
        return _joined(value, self._box_parts, np.float32)

    def discrete(self, value: Mapping[str, Any]) -> NDArray[np.int64]:
        """The choices of a value of the space, ``(..., m)`` int64."""
        return _joined(value, self._choice_parts, np.int64)

    def flatten(self, value: Mapping[str, Any]) -> Any:
        """A value of the given space as a value of ``self.space``."""
        if self.only_continuous:
            return self.continuous(value)
        if self.only_discrete:
            return self.discrete(value)
        return {"continuous": self.continuous(value), "discrete": self.discrete(value)}

    def unflatten(self, flat: Any) -> dict[str, Any]:
        """A value of ``self.space`` as a value of the given space, without what was left out."""
        value: dict[str, Any] = {}
        if not self.only_discrete:
            numbers = np.asarray(flat if self.only_continuous else flat["continuous"])
            value.update(_entries(numbers, self._box_parts))
        if not self.only_continuous:
            choices = np.asarray(flat if self.only_discrete else flat["discrete"])
            value.update(_entries(choices, self._choice_parts))
        return value


def _parts(parts: Mapping[str, spaces.Space[Any]]) -> list[_Part]:
    shapes = {key: part.shape or () for key, part in parts.items()}
    return [_Part(key, shape, int(np.prod(shape))) for key, shape in shapes.items()]


def _joined(value: Mapping[str, Any], parts: list[_Part], dtype: type[Number]) -> NDArray[Number]:
    """Entries ``(..., *shape)`` side by side as ``(..., n)``; a bare number is one entry."""
    columns = []
    for part in parts:
        array = np.asarray(value[part.key], dtype)
        lead = array.shape[: max(array.ndim - len(part.shape), 0)]
        columns.append(array.reshape(*lead, part.size))
    return np.concatenate(columns, axis=-1)


def _entries(array: NDArray[Any], parts: list[_Part]) -> dict[str, Any]:
    """``(..., n)`` cut up into ``(..., *shape)``, one piece for each part."""
    expected = sum(part.size for part in parts)
    if array.ndim == 0 or array.shape[-1] != expected:
        names = ", ".join(part.key for part in parts)
        raise ValueError(
            f"got an array of shape {array.shape} for {names}; "
            f"expected {expected} values on its last axis."
        )
    entries: dict[str, Any] = {}
    begin = 0
    for part in parts:
        piece = array[..., begin : begin + part.size]
        entries[part.key] = piece.reshape((*array.shape[:-1], *part.shape))[()]
        begin += part.size
    return entries


def _cannot_flatten(key: str, part: spaces.Space[Any]) -> str:
    advice = (
        "Put ConstantSizedObservations inside this wrapper."
        if isinstance(part, spaces.Sequence)
        else "Leave it out, or turn it into a Box, with a wrapper of your own."
    )
    return f"cannot flatten {key!r}, which is {part!r}. {advice}"
