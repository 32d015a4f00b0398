"""The oracle of ``agents/planning/viewer.c`` and of ``plan_karts`` in NumPy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from stkzoo import PowerupType
from stkzoo.agents.planning.memory import MARK_COUNT, MARK_SPACING, RIVALS, PlanMemory
from stkzoo.agents.planning.motion import BOOST_STEPS, RELEASE_STEPS, STEP
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.plans import PlanTable
from stkzoo.agents.planning.worth import LEAST_LOGIT
from stkzoo.wrappers.racing import OWN_PLACES, Surroundings
from tests.oracle import plan_weigher
from tests.oracle.observations import to_polar
from tests.oracle.road_ahead import RoadAhead
from tests.oracle.vectors import squared

FloatArray = npt.NDArray[np.float32]
DoubleArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Arrays = tuple[npt.NDArray[Any], ...]

_MANEUVERS, _BRAKE, _OFFSETS, _ITEMS = 4, 1, 7, 8
_SLOWEST, _LEAST_LOCK = 5.0, 0.02
_NEAREST, _FARTHEST, _BEYOND, _LEVEL = 1.0, 60.0, 1.0, 4.0
_REACH, _FASTEST, _NOWHERE, _MOST_TURNED = 25.0, 50.0, 1e3, 0.6
#: Logit per meter of worth, and logit of a button.
_METER, _BUTTON = 2.0, 2.0


def plan_karts(
    plans: tuple[Any, ...],
    memory: FloatArray,
    around: Arrays,
    line: FloatArray | None,
    moments: FloatArray | None,
    out: Arrays,
    first: int,
) -> None:
    """Writes the best plan of each maneuver, and what a policy needs to choose among them."""
    numbers, worths, table, motion, logits = plans
    rules, best, inputs = DriverParameters(*numbers.tolist()), out[0], out[3]
    seen = survey(rules, worths, PlanMemory(*memory), Surroundings(*around), line, moments)
    plan_weigher.weigh_plans(PlanTable(*table), rules, motion, *seen[:5], best)
    out[1][:] = seen.scene[:, :3]
    state = PlanMemory(*memory), own_parts(around[0])
    _write_prior(rules, *state, best, seen.scene, logits, out[2])
    if inputs.shape[1]:
        _write_inputs(best, seen.scene, seen.rivals, inputs[:, first:])


def own_parts(own: FloatArray) -> dict[str, FloatArray]:
    """Returns the own state of karts by name, ``(A,)`` or ``(A, 3)``."""
    return {
        key: np.squeeze(own[:, place], 1) if place.stop - place.start == 1 else own[:, place]
        for key, place in OWN_PLACES.items()
    }


class Surveyed(NamedTuple):
    """Arguments of ``weigh_plans``, and where karts are."""

    rows: IntArray
    karts: FloatArray
    road: FloatArray
    items: DoubleArray
    rivals: DoubleArray
    scene: FloatArray


def survey(
    rules: DriverParameters,
    worths: FloatArray,
    remembered: PlanMemory,
    around: Surroundings,
    line: FloatArray | None,
    moments: FloatArray | None,
) -> Surveyed:
    """Computes the arguments of ``weigh_plans``, and where the karts are; writes ``moments``."""
    if line is None:
        line = around.road[:, -MARK_COUNT - 1 :][..., [0, 1, 2, 3, 3]]
    count, own = len(around.ego), own_parts(around.ego)
    velocity, speed = own["velocity"], own["velocity"][:, 2]
    road = RoadAhead.of(line, headings_of(line), MARK_SPACING)
    turned, rivals = np.zeros(count, np.float32), np.zeros((count, RIVALS, 5))
    if moments is not None:
        turned, rivals = _rivals(around.karts, velocity, road, moments)
    items = _items(road, around.items, around.item_types, worths, own, rules)
    assumed = np.maximum(speed, np.float32(_SLOWEST))
    reach = (rules.aim_distance + rules.aim_time * assumed).astype(np.float32)
    lock = np.tan(np.maximum(own["max_steer_angle"], np.float32(_LEAST_LOCK)))
    is_jumping = own["jumping"] > 0
    columns = (
        assumed,
        assumed * lock / rules.wheel_base,
        reach,
        remembered.turn,
        remembered.drift_turn,
        road.offset,
        road.angle,
        remembered.boost_steps,
        remembered.big_boost_steps,
        (speed > rules.drift_speed) & ~is_jumping & (remembered.hop_steps == 0),
        speed > rules.brake_speed,
        velocity[:, 0],
        turned,
        remembered.drift_side,
        remembered.drift_steps,
        remembered.release_steps,
    )
    karts = np.stack([np.asarray(column, np.float32) for column in columns], axis=1)
    rows = table_rows(
        remembered.drift_side,
        remembered.drift_steps,
        remembered.release_steps,
        (RELEASE_STEPS, BOOST_STEPS[1]),
    )
    is_cautious = remembered.caution_steps > 0
    widest = np.where(is_cautious, rules.caution_room, rules.greatest_room)[:, None]
    left, right = (
        np.minimum(np.maximum(edge - rules.margin, 0.3), widest).astype(np.float32)
        for edge in (road.left, road.right)
    )
    marks = np.empty((count, 4, MARK_COUNT), np.float32)
    write_road(road, reach, (left, right), marks)
    scene = (
        road.angle,
        road.offset,
        np.maximum(road.offset - road.right[:, 0], -road.offset - road.left[:, 0]),
        road.straightness(rules.straight_time * speed),
        _is_useful(around.items, around.item_types, own, rules),
    )
    return Surveyed(rows, karts, marks, items, rivals, np.stack(scene, axis=1, dtype=np.float32))


def headings_of(line: FloatArray) -> FloatArray:
    """Returns the directions of a road after its marks, relative to the kart's [rad]."""
    return to_polar(line[:, 1:, :3] - line[:, :-1, :3])[..., 0]


def table_rows(
    drift_side: npt.NDArray[Any],
    drift_steps: npt.NDArray[Any],
    release_steps: npt.NDArray[Any],
    most: tuple[int, int],
) -> IntArray:
    """Returns the states of karts in a table of plans, ``(A,)``.

    Args:
        drift_side: ``(A,)`` 1 in a drift to the right, -1 to the left, 0 outside drifts.
        drift_steps: ``(A,)`` duration of the drift [steps].
        release_steps: ``(A,)`` remaining time of the turn after the last drift [steps].
        most: limits of ``release_steps`` and of ``drift_steps``; larger numbers count as the limit.
    """
    release, longest = most
    steps = np.minimum(drift_steps, longest).astype(np.intp)
    drifting = release + 1 + np.where(drift_side > 0, longest + 1, 0) + steps
    rows = np.where(drift_side == 0, np.minimum(release_steps, release), drifting)
    return np.asarray(rows, np.intp)


def write_road(
    road: RoadAhead, reach: FloatArray, rooms: tuple[FloatArray, FloatArray], out: FloatArray
) -> None:
    """Writes the argument ``road`` of ``weigh_plans``, ``(A, 4, M)``.

    Args:
        road: the road.
        reach: ``(A,)`` distance at which karts aim [m].
        rooms: ``(A, M)`` largest offsets from the middle to the left and to the right [m].
        out: array to write.
    """
    out[:, 0] = road.bends(reach) * (0.5 * reach * reach)[:, None]
    out[:, 1], out[:, 2] = rooms
    out[:, 3] = road.curvature


def _items(
    road: RoadAhead,
    items: FloatArray,
    types: npt.NDArray[np.int64],
    worths: FloatArray,
    own: dict[str, FloatArray],
    rules: DriverParameters,
) -> DoubleArray:
    """Returns the relevant items ahead, nearest first, ``(A, 8, 4)``; see ``weigh_plans``."""
    squares = squared(items)
    is_known = (types >= 0) & (types < worths.shape[1])
    has_powerup = (own["powerup_type"] != 0).astype(np.intp)
    worth = worths[has_powerup[:, None], np.where(is_known, types, 0)]
    matters = is_known & (worth != 0) & (items[..., 2] > 0)
    matters &= squares < (_FARTHEST + 5.0) ** 2
    keys = np.where(matters, squares, np.inf)
    order = np.argsort(keys, axis=1, kind="stable")[:, :_ITEMS]
    rows = np.arange(len(items))[:, None]
    worth, matters = worth[rows, order], matters[rows, order]
    at = road.place(items[rows, order])
    is_kept = (at.along > _NEAREST) & (at.along < _FARTHEST)
    is_kept &= np.abs(at.above) < _LEVEL
    is_kept &= at.across < at.right + _BEYOND
    is_kept &= -at.across < at.left + _BEYOND
    radii = np.array([rules.bad_item_radius, rules.item_radius], np.float32)
    radius = radii[(worth > 0).astype(np.intp)]
    columns = np.zeros((len(items), _ITEMS, 4))
    for number, column in enumerate((at.along, at.across, np.where(is_kept, worth, 0), radius)):
        columns[:, : order.shape[1], number] = np.where(matters, column, 0)
    return columns


def _is_useful(
    items: FloatArray,
    types: npt.NDArray[np.int64],
    own: dict[str, FloatArray],
    rules: DriverParameters,
) -> npt.NDArray[np.bool_]:
    """Returns whether each kart should fire. The switch is not used near items it would spoil."""
    is_close = (items[..., 2] > 0) & (squared(items) < rules.switch_reach**2) & (types >= 0)
    spoils = (own["powerup_type"] == PowerupType.SWITCH) & is_close.any(axis=1)
    return np.asarray((own["powerup_count"] > 0) & ~spoils)


# ------------------------------------------------------------------ the nearest karts


def _rivals(
    karts: FloatArray, velocity: FloatArray, road: RoadAhead, moments: FloatArray
) -> tuple[FloatArray, DoubleArray]:
    """Returns the turn since the last step and the nearest karts; writes this step's moment.

    Returns:
        ``(A,)``, positive to the right [rad], and ``(A, R, 5)``, nearest first.
    """
    near, own, headings = moment_of(moments[:, 1])
    spots, is_there = _nearest(karts, RIVALS)
    at = road.place(spots)
    is_there &= np.abs(at.above) < _LEVEL
    near[:] = np.where(is_there[..., None], spots[..., ::2], _NOWHERE)
    own[:], headings[:] = velocity[:, ::2], road.headings
    turned, moved = _moved(road, moment_of(moments[:, 0]), near, own)
    is_known = is_there & (_length(moved) < _FASTEST)
    sines, cosines = np.sin(at.headings), np.cos(at.headings)
    gain = moved[..., 0] * sines + moved[..., 1] * cosines - _length(own)[:, None]
    drift = moved[..., 0] * cosines - moved[..., 1] * sines
    columns = np.zeros((*is_there.shape, 5))
    columns[..., 0] = is_there
    columns[..., 1] = np.where(is_there, at.along, 0)
    columns[..., 2] = np.where(is_there, at.across, 0)
    columns[..., 3] = np.where(is_known, gain, 0)
    columns[..., 4] = np.where(is_known, drift, 0)
    return turned, columns


def moment_of(moments: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Returns the parts of moments: nearest karts, velocity, and directions of the road."""
    ends = 2 * RIVALS, 2 * RIVALS + 2
    spots = moments[:, : ends[0]].reshape(len(moments), RIVALS, 2)
    return spots, moments[:, ends[0] : ends[1]], moments[:, ends[1] :]


def _moved(
    road: RoadAhead, before: Arrays, near: FloatArray, own: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns the turn since the last step and velocities of nearby karts.

    Returns:
        ``(A,)``, positive to the right [rad], and ``(A, R, 2)``, right and forward [m/s].
    """
    spots, velocity, headings = before
    way = (own + velocity) * np.float32(STEP / 2)
    turned = road.turned_since(headings, _length(way), _MOST_TURNED)
    half = turned * np.float32(0.5)
    # previous positions in the current frame, after this kart's motion and rotation
    stayed = _turned(_turned(spots, half) - way[:, None], half)
    moved = (near[:, :, None] - stayed[:, None]) / np.float32(STEP)
    # match each kart with the nearest previous position
    strangeness = np.abs(moved - own[:, None, None]).sum(-1)
    same = strangeness.argmin(axis=2)
    found: FloatArray = moved[np.arange(len(same))[:, None], np.arange(same.shape[1]), same]
    return turned, found


def _length(vectors: FloatArray) -> FloatArray:
    """Returns lengths ``(...)`` of vectors ``(..., 2)``."""
    right, ahead = vectors[..., 0], vectors[..., 1]
    lengths: FloatArray = np.sqrt(right * right + ahead * ahead)
    return lengths


def _turned(spots: FloatArray, angles: FloatArray) -> FloatArray:
    """Rotates positions ``(A, R, 2)``, right and ahead, for karts that turned right."""
    sines, cosines = np.sin(angles)[:, None], np.cos(angles)[:, None]
    right, ahead = spots[..., 0], spots[..., 1]
    turned = np.empty_like(spots)
    turned[..., 0] = right * cosines - ahead * sines
    turned[..., 1] = right * sines + ahead * cosines
    return turned


def _nearest(karts: FloatArray, most: int) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Returns the nearest karts ``(A, most, 3)``, and a mask of those that exist."""
    if (missing := most - karts.shape[1]) > 0:
        nobody = np.full((len(karts), missing, 3), np.inf, np.float32)
        karts = np.concatenate([karts, nobody], axis=1)
    squares = squared(karts)
    order = np.argsort(squares, axis=1, kind="stable")[:, :most]
    rows = np.arange(len(karts))[:, None]
    spots = karts[rows, order]
    is_there: npt.NDArray[np.bool_] = squares[rows, order] < _REACH**2
    return np.where(is_there[..., None], spots, 0).astype(np.float32), is_there


# ------------------------------------------------------------------ inputs of a policy


def _write_prior(
    rules: DriverParameters,
    remembered: PlanMemory,
    own: dict[str, FloatArray],
    best: FloatArray,
    scene: FloatArray,
    logits: FloatArray,
    prior: FloatArray,
) -> None:
    """Writes the logits of the rules."""
    worth, turns, dangers = best
    rows = np.arange(len(worth))
    chosen = worth.argmax(axis=1)
    is_safe = (dangers[rows, chosen] < rules.danger) & (chosen != _BRAKE)
    nitro = (
        is_safe
        & (remembered.nitro_steps == 0)
        & (own["velocity"][:, 2] > rules.nitro_speed)
        & (np.abs(turns[rows, chosen]) < rules.nitro_turn)
        & (own["energy"] > 0)
        & ~(own["jumping"] > 0)
    )
    is_straight = (np.abs(scene[:, 0]) < rules.straight_aim) & (scene[:, 3] < rules.straight_angle)
    fire = is_safe & is_straight & (scene[:, 4] > 0) & (remembered.since_fire >= rules.fire_every)
    behind = worth - worth[rows, chosen][:, None]
    prior[:, :_MANEUVERS] = np.maximum(_METER * behind, LEAST_LOGIT)
    prior[:, _MANEUVERS : _MANEUVERS + _OFFSETS] = logits
    for number, is_pressed in enumerate((nitro, fire)):
        pressed = np.where(is_pressed, _BUTTON, -_BUTTON)
        prior[:, 2 * number - 4], prior[:, 2 * number - 3] = -pressed, pressed


def _write_inputs(
    best: FloatArray, scene: FloatArray, rivals: DoubleArray, inputs: FloatArray
) -> None:
    """Writes a policy's inputs from the plans and the nearest karts."""
    worth, turns, dangers = best
    behind = worth - worth.max(axis=1)[:, None]
    angle, offset, _, straightness, _ = scene.T
    numbers = inputs[:, : 4 * _MANEUVERS + 3]
    numbers[:, 0:-3:4] = behind > LEAST_LOGIT / _METER * 10
    numbers[:, 1:-3:4] = np.maximum(behind / 10.0, -2.0)
    numbers[:, 2:-3:4] = turns
    numbers[:, 3:-3:4] = np.minimum(dangers / 10.0, 2.0)
    numbers[:, -3], numbers[:, -2], numbers[:, -1] = angle, offset / 10.0, straightness
    is_there, along, across, gain, drift = np.moveaxis(rivals, -1, 0)
    columns = inputs[:, numbers.shape[1] :]
    aside = np.where(is_there > 0, across.astype(np.float32) - offset[:, None], 0)
    parts = (is_there, along / 10.0, aside / 3.0, gain.astype("f4") / 5.0, drift.astype("f4") / 3.0)
    for number, part in enumerate(parts):
        columns[:, number : 5 * is_there.shape[1] : 5] = part
