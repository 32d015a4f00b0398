"""What comes of plans: where a kart would get to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.kart import RELEASE_TURN, STEERING_LAG

from .plans import SPANS, Plans
from .road import SPACING, Road

__all__ = ["Forecast", "Motion", "forecast"]

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Motion:
    """How the kart moves now.

    Attributes:
        speed: forward [m/s].
        lock: how fast it turns at full lock [rad/s].
        turn: the share of full lock that it turned by in the last step, positive to the right.
        drift_turn: the same of the last step of its last drift.
    """

    speed: float
    lock: float
    turn: float
    drift_turn: float


@dataclass(frozen=True, slots=True)
class Forecast:
    """Where plans lead: ``C`` plans, ``T`` moments.

    Attributes:
        along: ``(T, C)`` way along the road at the end of each moment [m].
        across: ``(T, C)`` distance from the middle of the road, positive to the right [m].
        room: ``(T, C)`` the distance that there may be [m].
        angles: ``(C,)`` last direction, 0 is the road's [rad].
        turns: ``(C,)`` share of full lock to turn by now, positive to the right.
    """

    along: FloatArray
    across: FloatArray
    room: FloatArray
    angles: FloatArray
    turns: FloatArray


def forecast(
    plans: Plans,
    road: Road,
    room: FloatArray,
    motion: Motion,
    reach: float,
    item_lanes: FloatArray,
) -> Forecast:
    """Drives all plans at once.

    A kart steers for a point of its lane ahead, as far as its plan lets it.

    Args:
        plans: ``C`` plans.
        road: the road.
        room: ``(COUNT,)`` how far from its middle the kart may be [m].
        motion: the kart's.
        reach: how far ahead the point is [m].
        item_lanes: ``(ITEM_LANES,)`` how far from the middle of the road the items are [m].
    """
    moments, count = plans.lanes.shape
    # what turns into a share of full lock, for each m/s of speed
    pull, damp = 2.0 / (reach * reach * motion.lock), 2.0 / (reach * motion.lock)
    speeds = np.maximum(motion.speed + plans.slower, 4.0)
    steps = speeds * SPANS[:, None]
    shares = speeds * pull
    table = np.stack([road.bends(reach) * (0.5 * reach * reach), room, road.curvature])
    extra = np.where(plans.items < 0, 0.0, item_lanes[plans.items])
    releases = plans.releases * (RELEASE_TURN / motion.lock)
    along, across, ahead = (np.empty((moments, count)) for _ in range(3))
    at, beside = np.zeros(count), np.full(count, road.offset)
    angle = np.full(count, road.angle)
    last_turn = np.full(count, motion.drift_turn)
    here = np.empty((3, count))
    marks = np.zeros(count, np.intp)
    ratio = damp / pull
    for moment in range(moments):
        table.take(marks, axis=1, mode="clip", out=here)
        bend, width, curvature = here
        if moment:
            ahead[moment - 1] = width
        turn = plans.lanes[moment] * width
        turn += extra
        turn -= beside
        turn += bend
        turn -= angle * ratio
        turn *= shares[moment]
        np.maximum(turn, plans.least[moment], out=turn)
        np.minimum(turn, plans.most[moment], out=turn)
        np.copyto(last_turn, turn, where=plans.drifts[moment])
        if moment == 0:
            turns = turn.copy()
            turn += (motion.turn - turn) * STEERING_LAG
        turn += last_turn * releases[moment]
        turn *= motion.lock * SPANS[moment]
        # along the road the inner side of a curve is the shorter one
        way = beside * curvature
        np.subtract(1.0, way, out=way)
        np.maximum(way, 0.3, out=way)
        np.divide(steps[moment], way, out=way)
        turn -= way * curvature
        turn *= 0.5
        angle += turn
        way *= np.cos(angle)
        at += way
        beside = np.sin(angle)
        beside *= steps[moment]
        beside += across[moment - 1] if moment else road.offset
        angle += turn
        along[moment], across[moment] = at, beside
        marks = (at * (1.0 / SPACING)).astype(np.intp)
    room.take(marks, mode="clip", out=ahead[-1])
    return Forecast(along, across, ahead, angle, turns)
