"""Own state and surroundings of karts, from observations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stkzoo.kernel import look_along, stack_vectors
from stkzoo.wrappers.racing.features import OWN_KINDS, OWN_NUMBERS
from stkzoo.wrappers.racing.road import LOOKS, STEP, traced

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[Any]

#: Type number of a missing item.
ABSENT = -1


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Surroundings of A karts, each in its own frame: x right, y up, z forward [m].

    Attributes:
        road: ``(A, L, 4)`` points of the line and distances to the edge; by default at
            :data:`LOOKS`.
        karts: ``(A, K, 3)`` positions of the other karts; not finite if missing.
        items: ``(A, M, 3)`` positions of the items.
        item_types: ``(A, M)`` numbers of :class:`~stkzoo.names.ItemType`, or :data:`ABSENT`.
        line: ``(A, L, 5)`` points of the racing line at ``GROUND_LINE_MARKS``, and the room to its
            left and right; ``None`` if it is not observed.
    """

    road: FloatArray
    karts: FloatArray
    items: FloatArray
    item_types: IntArray
    line: FloatArray | None = None


#: Own state of karts (entries of the ``full`` view in batch form), and their surroundings.
Known: TypeAlias = tuple[dict[str, npt.NDArray[Any]], Surroundings]


def surroundings_of(
    observation: Mapping[str, Any] | Sequence[Mapping[str, Any]], looks: FloatArray = LOOKS
) -> Known:
    """Returns own state and surroundings of karts from observations in the ``full`` view.

    Args:
        observation: an observation of one kart, a batch, or a list of observations, also from
            different races.
        looks: ``(L,)`` distances at which the road is observed [m].
    """
    if isinstance(observation, Mapping):
        is_batch = np.ndim(observation["velocity"]) > 1
        batch = observation if is_batch else {key: [value] for key, value in observation.items()}
    else:
        keys = (*_KEYS, *(key for key in _LINE if key in observation[0]))
        batch = {key: [one[key] for one in observation] for key in keys}
    lines, first = traced(*(tuple(batch[key]) for key in _PATHS))
    road = np.empty((len(lines), len(looks), 4), np.float32)
    look_along(lines, STEP, first, np.ascontiguousarray(looks, np.float32), road)
    around = Surroundings(
        road=road,
        karts=_stacked(batch["karts_position"], np.inf),
        items=_stacked(batch["items_position"], 0.0),
        item_types=_stacked_types(batch["items_type"]),
        line=_line_of(batch),
    )
    own = {key: np.asarray(batch[key]) for key in (*OWN_NUMBERS, *OWN_KINDS)}
    return own, around


_PATHS = ("paths_start", "paths_end", "paths_width")
_LINE = ("ground_line", "ground_room")
_KEYS = (*OWN_NUMBERS, *OWN_KINDS, *_PATHS, "karts_position", "items_position", "items_type")


def _stacked(rows: Sequence[Any], blank: float) -> FloatArray:
    """Stacks the karts' vectors, padded to equal lengths."""
    stacked = np.empty((len(rows), max(map(len, rows)), 3), np.float32)
    stack_vectors(tuple(rows), blank, stacked)
    return stacked


def _line_of(batch: Mapping[str, Any]) -> FloatArray | None:
    """Returns the racing lines ahead of the karts, if they are observed."""
    if _LINE[0] not in batch:
        return None
    return np.concatenate([np.asarray(batch[key], np.float32) for key in _LINE], axis=-1)


def _stacked_types(rows: Sequence[Any]) -> IntArray:
    stacked = np.full((len(rows), max(map(len, rows))), ABSENT, np.int64)
    for row, types in zip(stacked, rows, strict=True):
        row[: len(types)] = types
    return stacked
