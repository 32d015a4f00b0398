"""Estimates the motion of nearby karts from their positions in successive steps.

An observation has the positions of other karts but neither their velocities nor their identities.
The observing kart's own motion is known: its velocity, and its rotation from the apparent rotation
of the road. Once this is subtracted, other karts move little in a step, so each is matched with the
nearest previous position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from stkzoo.mdp import squared

from .arrays import BoolArray, FloatArray, IntArray
from .kart import STEP
from .road import MARK_COUNT, RoadAhead

#: Number of nearest karts to track, and their maximum distance [m].
RIVALS, _REACH = 4, 25.0
#: Karts farther above or below than this are on another level of the track [m].
_LEVEL = 4.0
#: A match that implies a higher speed is rejected [m/s].
_FASTEST = 50.0
_NOWHERE = np.float32(1e3)


@dataclass(frozen=True, slots=True)
class Rivals:
    """The nearest karts of A karts, nearest first, ``(A, RIVALS)`` each.

    Attributes:
        is_there: whether there is such a kart; otherwise its numbers are 0.
        along: distance ahead along the road [m].
        across: offset from the middle of the road, positive to the right [m].
        gain: speed along the road relative to the observing kart [m/s].
        drift: speed across the road, positive to the right [m/s].
    """

    is_there: BoolArray
    along: FloatArray
    across: FloatArray
    gain: FloatArray
    drift: FloatArray

    def columns(self) -> npt.NDArray[np.float64]:
        """The attributes as one array, ``(A, RIVALS, 5)``, in their order."""
        columns = np.empty((*self.is_there.shape, 5))
        for number, entry in enumerate(fields(self)):
            columns[..., number] = getattr(self, entry.name)
        return columns

    def numbers(self, offset: FloatArray) -> FloatArray:
        """Returns a policy's inputs from the rivals, ``(A, 5 * RIVALS)``.

        Args:
            offset: ``(A,)`` offset of the observing kart from the middle of the road, positive to
                the right [m].
        """
        numbers = np.empty((*self.is_there.shape, 5), np.float32)
        numbers[..., 0] = self.is_there
        numbers[..., 1] = self.along / 10.0
        numbers[..., 2] = np.where(self.is_there, self.across - offset[:, None], 0) / 3.0
        numbers[..., 3] = self.gain / 5.0
        numbers[..., 4] = self.drift / 3.0
        return numbers.reshape(len(offset), -1)


#: Signs of :meth:`Rivals.numbers` in a mirrored race.
RIVALS_MIRROR = np.tile(np.array([1, 1, -1, 1, -1], np.float32), RIVALS)


@dataclass(frozen=True, slots=True)
class _Moment:
    """Observations of A karts at one moment.

    Attributes:
        spots: ``(A, RIVALS, 2)`` positions of the nearest karts, right and ahead [m].
        velocity: ``(A, 2)`` velocity of the observing kart, right and ahead [m/s].
        headings: ``(A, 36)`` headings of the road ahead [rad].
    """

    spots: FloatArray
    velocity: FloatArray
    headings: FloatArray

    @classmethod
    def unknown(cls, count: int) -> _Moment:
        return cls(
            np.full((count, RIVALS, 2), _NOWHERE, np.float32),
            np.zeros((count, 2), np.float32),
            np.zeros((count, MARK_COUNT), np.float32),
        )

    @classmethod
    def joined(cls, moments: Sequence[_Moment]) -> _Moment:
        return cls(
            *(np.concatenate([getattr(m, entry.name) for m in moments]) for entry in fields(cls))
        )

    def of(self, rows: slice) -> _Moment:
        return _Moment(*(getattr(self, entry.name)[rows] for entry in fields(self)))

    def put(self, rows: IntArray, other: _Moment) -> None:
        for entry in fields(self):
            getattr(self, entry.name)[rows] = getattr(other, entry.name)


class RivalTracker:
    """Tracks the nearest karts of A karts from step to step.

    Args:
        count: number of karts, A.
    """

    def __init__(self, count: int) -> None:
        self._now = _Moment.unknown(count)
        self._before = _Moment.unknown(count)

    @classmethod
    def joined(cls, trackers: Sequence[RivalTracker]) -> RivalTracker:
        """Returns a joint tracker of several trackers for one step."""
        joined = cls(0)
        joined._now = _Moment.joined([tracker._now for tracker in trackers])
        return joined

    def take(self, joined: RivalTracker, rows: slice) -> None:
        """Copies the observations of some karts from a joint tracker."""
        self._before, self._now = joined._before.of(rows), joined._now.of(rows)

    def look(self) -> None:
        """Advances the tracker by one step."""
        self._before = self._now

    def watch(self, karts: FloatArray, velocity: FloatArray, road: RoadAhead) -> Rivals:
        """Returns the nearby karts; you may call it again before the next step.

        Args:
            karts: ``(A, K, 3)`` other karts in the observing kart's frame [m]; not finite if
                missing.
            velocity: ``(A, 3)`` velocity of the observing kart in its frame [m/s].
            road: the road ahead.
        """
        spots, is_there = _nearest(karts)
        at = road.place(spots)
        is_there &= np.abs(at.above) < _LEVEL
        flat = np.where(is_there[..., None], spots[..., ::2], _NOWHERE).astype(np.float32)
        own = velocity[:, ::2].astype(np.float32)
        self._now = _Moment(flat, own, road.headings)
        moved = self._moved(road)
        speed = _length(moved)
        is_known = is_there & (speed < _FASTEST)
        sines, cosines = np.sin(at.headings), np.cos(at.headings)
        pace = _length(own)[:, None]
        gain = moved[..., 0] * sines + moved[..., 1] * cosines - pace
        drift = moved[..., 0] * cosines - moved[..., 1] * sines
        return Rivals(
            is_there,
            np.where(is_there, at.along, 0),
            np.where(is_there, at.across, 0),
            np.where(is_known, gain, 0),
            np.where(is_known, drift, 0),
        )

    def _moved(self, road: RoadAhead) -> FloatArray:
        """Returns velocities of nearby karts, right and forward, ``(A, RIVALS, 2)`` [m/s]."""
        now, before = self._now, self._before
        way = (now.velocity + before.velocity) * np.float32(STEP / 2)
        half = road.turned_since(before.headings, _length(way)) * np.float32(0.5)
        # previous positions in the current frame, after this kart's motion and rotation
        stayed = _turned(_turned(before.spots, half) - way[:, None], half)
        moved = (now.spots[:, :, None] - stayed[:, None]) / np.float32(STEP)
        # match each kart with the nearest previous position
        strangeness = np.abs(moved - now.velocity[:, None, None]).sum(-1)
        same = strangeness.argmin(axis=2)
        found: FloatArray = moved[np.arange(len(same))[:, None], np.arange(RIVALS), same]
        return found

    def forget(self, rows: IntArray) -> None:
        """Resets some karts."""
        nothing = _Moment.unknown(len(rows))
        for moment in (self._before, self._now):
            moment.put(rows, nothing)


def _length(vectors: FloatArray) -> FloatArray:
    """Returns lengths ``(...)`` of vectors ``(..., 2)``; faster than ``np.linalg.norm``."""
    right, ahead = vectors[..., 0], vectors[..., 1]
    lengths: FloatArray = np.sqrt(right * right + ahead * ahead)
    return lengths


def _turned(spots: FloatArray, angles: FloatArray) -> FloatArray:
    """Rotates positions ``(A, I, 2)``, right and ahead, for karts that turned right."""
    sines, cosines = np.sin(angles)[:, None], np.cos(angles)[:, None]
    right, ahead = spots[..., 0], spots[..., 1]
    turned = np.empty_like(spots)
    turned[..., 0] = right * cosines - ahead * sines
    turned[..., 1] = right * sines + ahead * cosines
    return turned


def _nearest(karts: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Returns the nearest karts ``(A, RIVALS, 3)``, and a mask of those that exist."""
    if (missing := RIVALS - karts.shape[1]) > 0:
        nobody = np.full((len(karts), missing, 3), np.inf, np.float32)
        karts = np.concatenate([karts, nobody], axis=1)
    squares = squared(karts)
    order = np.argsort(squares, axis=1, kind="stable")[:, :RIVALS]
    rows = np.arange(len(karts))[:, None]
    spots = karts[rows, order]
    is_there: BoolArray = squares[rows, order] < _REACH**2
    return np.where(is_there[..., None], spots, 0).astype(np.float32), is_there
