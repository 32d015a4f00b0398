"""Own state and surroundings of karts, from observations or from snapshots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import KART_DTYPE, Snapshot
from stkzoo.mdp.geometry import rotation_matrices, to_kart_frame
from stkzoo.mdp.observations import OWN_KEYS, own_state
from stkzoo.wrappers.racing.road import (
    LOOKS,
    MAX_SEGMENTS,
    RoadArrays,
    points_ahead,
    road_line,
)

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
    """

    road: FloatArray
    karts: FloatArray
    items: FloatArray
    item_types: IntArray


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
        batch = {key: [one[key] for one in observation] for key in observation[0]}
    types = [np.asarray(kinds, np.int64).reshape(-1) for kinds in batch["items_type"]]
    around = Surroundings(
        road=_road(batch, looks),
        karts=_stacked(_rows(batch["karts_position"], 3), np.inf),
        items=_stacked(_rows(batch["items_position"], 3), 0),
        item_types=_stacked(types, ABSENT),
    )
    own = {key: np.asarray(batch[key]) for key in OWN_KEYS}
    return own, around


def _rows(lists: Any, width: int, limit: int | None = None) -> Sequence[FloatArray]:
    """Converts lists of vectors, one list per agent, to arrays ``(n, width)``."""
    blank = np.zeros((0, width), np.float32)
    return [
        (rows[:limit] if isinstance(rows, np.ndarray) else np.concatenate(rows[:limit])).reshape(
            -1, width
        )
        if len(rows)
        else blank
        for rows in lists
    ]


def _stacked(parts: Sequence[npt.NDArray[Any]], blank: float) -> npt.NDArray[Any]:
    """Stacks the agents' rows, padded to equal lengths."""
    return np.stack(parts) if len({*map(len, parts)}) == 1 else _padded(parts, blank)


def _road(batch: Mapping[str, Any], looks: FloatArray) -> FloatArray:
    starts, ends, widths = (
        _rows(batch[key], width, MAX_SEGMENTS)
        for key, width in (("paths_start", 3), ("paths_end", 3), ("paths_width", 1))
    )
    if not len(starts[0]):  # for example, an all-zero observation
        starts, ends, widths = (
            [np.zeros((1, rows.shape[1]), np.float32) for rows in paths]
            for paths in (starts, ends, widths)
        )
    lines = np.stack(
        [road_line(a, b, c[:, 0]) for a, b, c in zip(starts, ends, widths, strict=True)]
    )
    first, end = (np.stack([rows[0] for rows in paths]) for paths in (starts, ends))
    return points_ahead(lines, np.arange(len(lines)), first, end - first, looks)


def surroundings_in(
    road: RoadArrays,
    snapshots: Sequence[Snapshot],
    first_nodes: IntArray,
    karts: Sequence[IntArray],
    looks: FloatArray = LOOKS,
) -> Known:
    """Returns own state and surroundings of karts from snapshots of several races.

    Args:
        road: lines of one track, or of several tracks concatenated.
        snapshots: current snapshot of each race.
        first_nodes: first segment of each race's track in ``road``.
        karts: kart indices of each race, in grid order.
        looks: ``(L,)`` distances at which the road is observed [m].
    """
    race = np.repeat(np.arange(len(snapshots)), [len(who) for who in karts])
    chosen = [s.karts[who].tobytes() for s, who in zip(snapshots, karts, strict=True)]
    records = np.frombuffer(b"".join(chosen), KART_DTYPE)
    locations = records["location"]
    matrices = rotation_matrices(np.ascontiguousarray(records["rotation"]))
    lines, starts, along = road
    nodes = records["node"] + first_nodes[race]
    points = points_ahead(lines, nodes, starts[nodes] - locations, along[nodes], looks)
    seen = to_kart_frame(points[..., :3], locations, matrices)
    others = _padded([s.karts["location"] for s in snapshots], np.inf)[race]
    is_there = np.isfinite(others[..., 0])
    is_there[np.arange(len(race)), np.concatenate(karts)] = False
    rivals = to_kart_frame(np.where(is_there[..., None], others, 0), locations, matrices)
    rivals[~is_there] = np.inf
    items = _padded([s.items["location"] for s in snapshots], 0)[race]
    around = Surroundings(
        road=np.concatenate([seen, points[..., 3:]], axis=-1),
        karts=rivals,
        items=to_kart_frame(items, locations, matrices),
        item_types=_padded([s.items["type"].astype(np.int64) for s in snapshots], ABSENT)[race],
    )
    return own_state(records), around


def _padded(parts: Sequence[npt.NDArray[Any]], blank: float) -> npt.NDArray[Any]:
    """Stacks arrays of different lengths, each padded at its end with ``blank``."""
    most = max(1, *map(len, parts))
    padded = np.full((len(parts), most, *parts[0].shape[1:]), blank, parts[0].dtype)
    for row, part in zip(padded, parts, strict=True):
        row[: len(part)] = part
    return padded
