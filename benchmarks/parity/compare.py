"""Compares two recordings of one race entry by entry; see :mod:`benchmarks.parity.intended`."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.parity.intended import INTENDED, Difference, Intended, RaceContext
from benchmarks.parity.reference import Leaf, Recording
from stkzoo.engine.track import TrackMap

#: Maximum error, relative to the number's magnitude or to 1 (m, rad, s), whichever is larger.
#: Smaller tolerances fail: tracks extend 1 km from the world's origin, where adjacent float32
#: numbers are 6e-5 m apart, and the two sides subtract them in different orders.
TOLERANCE = 1e-4

_POSITIONS = {"items_position", "karts_position", "center_path", "paths_start", "paths_end"}
_PATHS = {"paths_distance", "paths_width", "paths_start", "paths_end"}


@dataclass
class Comparison:
    """Result of comparing two recordings.

    Attributes:
        steps: number of compared steps.
        max_error: largest error of a number; see :data:`TOLERANCE`.
        worst: path of that number.
        intended: number of differences by code of :data:`INTENDED`.
        undocumented: first occurrence of each difference that :data:`INTENDED` does not cover.
    """

    steps: int = 0
    max_error: float = 0.0
    worst: str = ""
    intended: Counter[str] = field(default_factory=Counter)
    undocumented: list[str] = field(default_factory=list)


def compare(
    ours: Recording,
    theirs: Recording,
    context: RaceContext,
    intended: Sequence[Intended] = INTENDED,
) -> Comparison:
    """Compares two recordings of a race with the same actions."""
    comparer = _Comparer(context, theirs.layout, intended)
    comparer.compare_spaces("observation_space", ours.observation_space, theirs.observation_space)
    comparer.compare_spaces("action_space", ours.action_space, theirs.action_space)
    comparer.compare_moments(ours, theirs)
    return comparer.result


class _Comparer:
    def __init__(
        self,
        context: RaceContext,
        layout: dict[str, list[tuple[str, tuple[int, ...]]]],
        intended: Sequence[Intended],
    ) -> None:
        self.result = Comparison()
        self._intended = intended
        self._context = context
        self._layout = layout
        self._orders: dict[int, tuple[list[int], list[int]]] = {}
        self._reported: set[tuple[str, str]] = set()

    def compare_spaces(self, name: str, ours: dict[str, str], theirs: dict[str, str]) -> None:
        for key in sorted(ours.keys() | theirs.keys()):
            if ours.get(key) != theirs.get(key):
                text = f"ours {ours.get(key)}, theirs {theirs.get(key)}"
                self._note(Difference("space", f"{name}/{key}", -1, text))

    def compare_moments(self, ours: Recording, theirs: Recording) -> None:
        if len(ours.moments) != len(theirs.moments):
            text = f"ours {len(ours.moments)} moments, theirs {len(theirs.moments)}"
            self._note(Difference("value", "length", len(ours.moments) - 1, text))
        for step, (our, their) in enumerate(zip(ours.moments, theirs.moments, strict=False)):
            self._compare_leaves("observation", step, our.observation, their.observation)
            self._compare_leaves("info", step, our.info, their.info)
            for name in ("reward", "terminated", "truncated"):
                values = (Leaf("", np.array(getattr(side, name))) for side in (our, their))
                self._compare_leaf(name, step, *values)
            self.result.steps = step

    def _compare_leaves(
        self, part: str, step: int, ours: dict[str, Leaf], theirs: dict[str, Leaf]
    ) -> None:
        if "" in theirs:  # the reference's continuous view of an AI agent has only its action
            theirs = {"action": theirs[""]}
        for key in ours.keys() - theirs.keys():
            self._note(Difference("extra", f"{part}/{key}", step, ours[key].kind))
        for key in theirs.keys() - ours.keys():
            self._note(Difference("missing", f"{part}/{key}", step, theirs[key].kind))
        by_agent: dict[str, list[tuple[str, Leaf, Leaf]]] = {}
        for key in sorted(ours.keys() & theirs.keys()):
            agent = key.partition("/")[0] if self._context.job.is_multi else ""
            entries = by_agent.setdefault(agent, [])
            entries.extend(self._entries(f"{part}/{key}", ours[key], theirs[key]))
        for entries in by_agent.values():
            self._compare_entries(step, entries)

    def _entries(self, path: str, ours: Leaf, theirs: Leaf) -> list[tuple[str, Leaf, Leaf]]:
        """Splits flattened vectors into their inner entries; returns other values unchanged."""
        inner = self._layout.get(path.removeprefix("observation/"), [])
        if not inner or ours.kind != theirs.kind:
            return [(path, ours, theirs)]
        entries = []
        begin = 0
        for name, shape in inner:
            end = begin + int(np.prod(shape))
            our, their = (
                Leaf(side.kind, side.values[begin:end].reshape(shape)) for side in (ours, theirs)
            )
            entries.append((f"{path}/{name}", our, their))
            begin = end
        return entries

    def _compare_entries(self, step: int, entries: list[tuple[str, Leaf, Leaf]]) -> None:
        """Compares the entries of one agent after matching objects at equal distances."""
        moves: dict[str, npt.NDArray[np.intp]] = {}
        for path, ours, theirs in entries:
            group, _, name = path.rpartition("/")[-1].partition("_")
            if name == "position":
                moves[group] = _matched_rows(ours.values, theirs.values, self._context.job.is_polar)
        for path, ours, theirs in entries:
            rows = moves.get(path.rpartition("/")[-1].partition("_")[0])
            if rows is not None and len(rows) == len(theirs.values):
                if (rows != np.arange(len(rows))).any():
                    self._note(Difference("order", path, step, "another order of near ties"))
                theirs = Leaf(theirs.kind, theirs.values[rows])
            if path.endswith("center_path_distance"):
                theirs = self._on_our_side(path, step, entries, ours, theirs)
            self._compare_leaf(path, step, ours, theirs)

    def _on_our_side(
        self, path: str, step: int, entries: list[tuple[str, Leaf, Leaf]], ours: Leaf, theirs: Leaf
    ) -> Leaf:
        """Returns the reference's distance, with our sign if the line is neither left nor right."""
        line = path.removesuffix("_distance")
        vector = next(their.values for name, _, their in entries if name == line)
        is_polar = self._context.job.is_polar
        length = vector[2] if is_polar else np.linalg.norm(vector)
        sideways = length * abs(np.sin(vector[0])) if is_polar else abs(vector[0])
        if sideways > TOLERANCE or np.sign(ours.values) == np.sign(theirs.values):
            return theirs
        self._note(Difference("order", path, step, "another side of a line straight ahead"))
        return Leaf(theirs.kind, np.copysign(length, ours.values))

    def _compare_leaf(self, path: str, step: int, ours: Leaf, theirs: Leaf) -> None:
        if ours.kind != theirs.kind:
            text = f"ours {ours.kind}, theirs {theirs.kind}"
            self._note(self._difference("type", path, step, text, ours, theirs))
        name = path.rsplit("/", 1)[-1]
        if name in _PATHS:
            theirs, is_reordered = self._in_our_order(path, step, ours, theirs)
            if is_reordered:
                self._note(Difference("order", path, step, "another order of segments"))
        if ours.values.shape != theirs.values.shape:
            text = f"ours {ours.values.shape}, theirs {theirs.values.shape}"
            self._note(self._difference("value", path, step, text, ours, theirs))
        elif ours.values.dtype.kind == "U":
            if ours.values != theirs.values:
                text = f"ours {ours.values}, theirs {theirs.values}"
                self._note(Difference("value", path, step, text))
        else:
            is_polar = name in _POSITIONS and self._context.job.is_polar
            is_vector = name in _POSITIONS or name in ("front", "velocity")
            errors = _errors(ours.values, theirs.values, is_polar, is_vector)
            error = float(errors.max(initial=0.0))
            if error > TOLERANCE:
                text = f"error {error:.2g}: {_worst_row(errors, ours.values, theirs.values)}"
                self._note(self._difference("value", path, step, text, ours, theirs))
            elif error > self.result.max_error:
                self.result.max_error, self.result.worst = error, path

    def _in_our_order(self, path: str, step: int, ours: Leaf, theirs: Leaf) -> tuple[Leaf, bool]:
        """Returns the reference's rows in our order; segments that it lacks get our values."""
        agent = Difference("", path, step, "").agent
        limit = len(theirs.values)
        orders = self._orders_from(self._context.nodes[step][agent])
        our_order, their_order = (order[:limit] for order in orders)
        if our_order == their_order or len(ours.values) != limit:
            return theirs, False
        rows = ours.values.copy()
        for row, segment in enumerate(our_order):
            if segment in their_order:
                rows[row] = theirs.values[their_order.index(segment)]
        return Leaf(theirs.kind, rows), True

    def _orders_from(self, node: int) -> tuple[list[int], list[int]]:
        """Returns the segments from a node on, in our order and in the reference's."""
        if node not in self._orders:
            track = self._context.track
            ours = track.nodes_ahead(np.array([node]))[0].tolist()
            self._orders[node] = ours, _order_of_reference(track, node)
        return self._orders[node]

    @staticmethod
    def _difference(
        aspect: str, path: str, step: int, text: str, ours: Leaf, theirs: Leaf
    ) -> Difference:
        sides = (side.values.astype(np.float64) for side in (ours, theirs))
        return Difference(aspect, path, step, text, *sides)

    def _note(self, difference: Difference) -> None:
        for intended in self._intended:
            if intended.covers(difference, self._context):
                self.result.intended[intended.code] += 1
                return
        kind = difference.aspect, difference.path
        if kind not in self._reported:
            self._reported.add(kind)
            self.result.undocumented.append(
                f"{difference.path} ({difference.aspect}), first at step {difference.step}: "
                f"{difference.text}"
            )


def _errors(
    ours: npt.NDArray[Any], theirs: npt.NDArray[Any], is_polar: bool, is_vector: bool
) -> npt.NDArray[np.float64]:
    """Returns the error of each number; see :data:`TOLERANCE`. Vectors count with their length."""
    a, b = ours.astype(np.float64), theirs.astype(np.float64)
    if not is_polar:
        size = np.linalg.norm(b, axis=-1, keepdims=True) if is_vector and b.size else np.abs(b)
        return np.asarray(np.abs(a - b) / np.maximum(size, 1.0))
    turns = np.abs((a[..., :2] - b[..., :2] + np.pi) % (2 * np.pi) - np.pi)
    radial = np.abs(a[..., 2:] - b[..., 2:]) / np.maximum(b[..., 2:], 1.0)
    return np.concatenate([turns * np.minimum(_arms(b), 1.0), radial], axis=-1)


def _worst_row(
    errors: npt.NDArray[np.float64], ours: npt.NDArray[Any], theirs: npt.NDArray[Any]
) -> str:
    if errors.ndim == 0:
        return f"ours {ours}, theirs {theirs}"
    row = int(np.unravel_index(np.argmax(errors), errors.shape)[0])
    return f"in row {row}, ours {ours[row]}, theirs {theirs[row]}"


def _arms(polar: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the lengths of the two arms that the two angles rotate, ``(..., 2)`` [m].

    An angle is ill-defined if its arm is short; for the first angle, this is straight above.
    """
    (sin_x, sin_y), (cos_x, cos_y) = (
        np.moveaxis(turn(polar[..., :2]), -1, 0) for turn in (np.sin, np.cos)
    )
    direction = np.stack([sin_x * np.abs(cos_y), sin_y * np.abs(cos_x), cos_x * cos_y], axis=-1)
    length = np.maximum(np.linalg.norm(direction, axis=-1, keepdims=True), 1e-12)
    x, y, z = np.moveaxis(direction / length * polar[..., 2:], -1, 0)
    return np.stack([np.hypot(x, z), np.hypot(y, z)], axis=-1)


def _matched_rows(
    ours: npt.NDArray[Any], theirs: npt.NDArray[Any], is_polar: bool
) -> npt.NDArray[np.intp]:
    """Returns the equal row of the reference for each of our rows, among rows that nearly tie."""
    rows = np.arange(len(theirs))
    if ours.shape != theirs.shape:
        return rows
    distances = theirs[:, 2] if is_polar else np.linalg.norm(theirs, axis=-1)
    for row in np.flatnonzero(_errors(ours, theirs, is_polar, True).max(axis=-1) > TOLERANCE):
        is_tie = np.abs(distances - distances[row]) <= 1e-6 * distances[row]
        for other in np.flatnonzero(is_tie):
            if _errors(ours[row], theirs[other], is_polar, True).max() <= TOLERANCE:
                rows[row] = other
    return rows if len(set(rows.tolist())) == len(rows) else np.arange(len(theirs))


def _order_of_reference(track: TrackMap, start: int) -> list[int]:
    """Returns the reference's order of segments, in which those within half a lap tie."""
    ends = track.path_distance[:, 1]
    order: dict[int, None] = {}
    queue = [(0.0, start)]
    while queue:
        _, node = heapq.heappop(queue)
        if node in order:
            continue
        order[node] = None
        for following in track.successors[node]:
            gap = abs(float(ends[following] - ends[start]))
            heapq.heappush(queue, (max(gap, track.length / 2), following))
    return list(order)
