"""The oracle of ``agents/planning/viewer.c`` in NumPy, which documents the arguments."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.memory import PlanMemory
from stkzoo.mdp.geometry import squared
from tests.oracle.road_ahead import RoadAhead

FloatArray = npt.NDArray[np.float32]
DoubleArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
Arrays = tuple[npt.NDArray[Any], ...]

_MANEUVERS, _BRAKE, _OFFSETS = 4, 1, 7


class _ViewRules(NamedTuple):
    """Parameters that apply to all karts."""

    mark_spacing: float
    slowest: float
    aim_distance: float
    aim_time: float
    wheel_base: float
    drift_speed: float
    brake_speed: float
    margin: float
    caution_room: float
    greatest_room: float
    straight_time: float
    item_radius: float
    bad_item_radius: float
    nearest: float
    farthest: float
    level: float
    beyond: float
    reach: float
    fastest: float
    nowhere: float
    step: float
    most_turned: float
    release_steps: float
    longest_drift: float
    switch: float
    switch_reach: float
    danger: float
    nitro_speed: float
    nitro_turn: float
    straight_aim: float
    straight_angle: float
    fire_every: float
    worth_scale: float
    never: float


class _Own(NamedTuple):
    """The karts' own state."""

    velocity: FloatArray
    energy: FloatArray
    jumping: npt.NDArray[np.int64]
    powerup_type: npt.NDArray[np.int64]
    powerup_count: npt.NDArray[np.int64]


def survey_road(
    rules: DoubleArray,
    worths: FloatArray,
    memory: FloatArray,
    own: Arrays,
    around: Arrays,
    before: Arrays,
    now: Arrays,
    out: Arrays,
) -> None:
    """Computes the arguments of ``weigh_plans``, and where the karts are."""
    known, remembered, state = _ViewRules(*rules.tolist()), PlanMemory(*memory), _Own(*own)
    line, headings, tangents, karts, items, types = around
    rows, kart_columns, road_columns, item_columns, rival_columns, scene = out
    road = RoadAhead.of(line, headings, known.mark_spacing)
    headings[:] = road.headings
    turned = np.zeros(len(rows), np.float32)
    if rival_columns.shape[1]:
        turned, rival_columns[:] = _rivals(karts, state.velocity, road, before, now, known)
    item_columns[:] = _items(road, items, types, worths, state, item_columns.shape[1], known)
    speed = state.velocity[:, 2]
    assumed = np.maximum(speed, known.slowest)
    reach = (known.aim_distance + known.aim_time * assumed).astype(np.float32)
    is_jumping = state.jumping > 0
    columns = (
        assumed,
        assumed * tangents.reshape(-1) / known.wheel_base,
        reach,
        remembered.turn,
        remembered.drift_turn,
        road.offset,
        road.angle,
        remembered.boost_steps,
        remembered.big_boost_steps,
        (speed > known.drift_speed) & ~is_jumping & (remembered.hop_steps == 0),
        speed > known.brake_speed,
        state.velocity[:, 0],
        turned,
        remembered.drift_side,
        remembered.drift_steps,
        remembered.release_steps,
    )
    for number, column in enumerate(columns):
        kart_columns[:, number] = column
    rows[:] = table_rows(
        remembered.drift_side,
        remembered.drift_steps,
        remembered.release_steps,
        (int(known.release_steps), int(known.longest_drift)),
    )
    is_cautious = remembered.caution_steps > 0
    widest = np.where(is_cautious, known.caution_room, known.greatest_room)[:, None]
    left, right = (
        np.minimum(np.maximum(edge - known.margin, 0.3), widest).astype(np.float32)
        for edge in (road.left, road.right)
    )
    write_road(road, reach, (left, right), road_columns)
    scene[:, 0], scene[:, 1] = road.angle, road.offset
    scene[:, 2] = np.maximum(road.offset - road.right[:, 0], -road.offset - road.left[:, 0])
    scene[:, 3] = road.straightness(known.straight_time * speed)
    scene[:, 4] = _is_useful(items, types, state, known)


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
    own: _Own,
    most: int,
    rules: _ViewRules,
) -> DoubleArray:
    """Returns the relevant items ahead, nearest first, ``(A, most, 4)``; see ``weigh_plans``."""
    squares = squared(items)
    is_known = (types >= 0) & (types < worths.shape[1])
    has_powerup = (own.powerup_type != 0).astype(np.intp)
    worth = worths[has_powerup[:, None], np.where(is_known, types, 0)]
    matters = is_known & (worth != 0) & (items[..., 2] > 0)
    matters &= squares < (rules.farthest + 5.0) ** 2
    keys = np.where(matters, squares, np.inf)
    order = np.argsort(keys, axis=1, kind="stable")[:, :most]
    rows = np.arange(len(items))[:, None]
    worth, matters = worth[rows, order], matters[rows, order]
    at = road.place(items[rows, order])
    is_kept = (at.along > rules.nearest) & (at.along < rules.farthest)
    is_kept &= np.abs(at.above) < rules.level
    is_kept &= at.across < at.right + rules.beyond
    is_kept &= -at.across < at.left + rules.beyond
    radii = np.array([rules.bad_item_radius, rules.item_radius], np.float32)
    radius = radii[(worth > 0).astype(np.intp)]
    columns = np.zeros((len(items), most, 4))
    for number, column in enumerate((at.along, at.across, np.where(is_kept, worth, 0), radius)):
        columns[:, : order.shape[1], number] = np.where(matters, column, 0)
    return columns


def _is_useful(
    items: FloatArray, types: npt.NDArray[np.int64], own: _Own, rules: _ViewRules
) -> npt.NDArray[np.bool_]:
    """Returns whether each kart should fire. The switch is not used near items it would spoil."""
    is_close = (items[..., 2] > 0) & (squared(items) < rules.switch_reach**2) & (types >= 0)
    spoils = (own.powerup_type == rules.switch) & is_close.any(axis=1)
    return np.asarray((own.powerup_count > 0) & ~spoils)


# ------------------------------------------------------------------ the nearest karts


def _rivals(
    karts: FloatArray,
    velocity: FloatArray,
    road: RoadAhead,
    before: Arrays,
    now: Arrays,
    rules: _ViewRules,
) -> tuple[FloatArray, DoubleArray]:
    """Returns the turn since the last step and the nearest karts; writes ``now``.

    Returns:
        ``(A,)``, positive to the right [rad], and ``(A, R, 5)``, nearest first.
    """
    near, own = now
    spots, is_there = _nearest(karts, near.shape[1], rules)
    at = road.place(spots)
    is_there &= np.abs(at.above) < rules.level
    near[:] = np.where(is_there[..., None], spots[..., ::2], rules.nowhere)
    own[:] = velocity[:, ::2]
    turned, moved = _moved(road, before, near, own, rules)
    is_known = is_there & (_length(moved) < rules.fastest)
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


def _moved(
    road: RoadAhead, before: Arrays, near: FloatArray, own: FloatArray, rules: _ViewRules
) -> tuple[FloatArray, FloatArray]:
    """Returns the turn since the last step and velocities of nearby karts.

    Returns:
        ``(A,)``, positive to the right [rad], and ``(A, R, 2)``, right and forward [m/s].
    """
    spots, velocity, headings = before
    way = (own + velocity) * np.float32(rules.step / 2)
    turned = road.turned_since(headings, _length(way), rules.most_turned)
    half = turned * np.float32(0.5)
    # previous positions in the current frame, after this kart's motion and rotation
    stayed = _turned(_turned(spots, half) - way[:, None], half)
    moved = (near[:, :, None] - stayed[:, None]) / np.float32(rules.step)
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


def _nearest(
    karts: FloatArray, most: int, rules: _ViewRules
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Returns the nearest karts ``(A, most, 3)``, and a mask of those that exist."""
    if (missing := most - karts.shape[1]) > 0:
        nobody = np.full((len(karts), missing, 3), np.inf, np.float32)
        karts = np.concatenate([karts, nobody], axis=1)
    squares = squared(karts)
    order = np.argsort(squares, axis=1, kind="stable")[:, :most]
    rows = np.arange(len(karts))[:, None]
    spots = karts[rows, order]
    is_there: npt.NDArray[np.bool_] = squares[rows, order] < rules.reach**2
    return np.where(is_there[..., None], spots, 0).astype(np.float32), is_there


# ------------------------------------------------------------------ inputs of a policy


def present_plans(
    rules: DoubleArray,
    logits: Arrays,
    memory: FloatArray,
    own: Arrays,
    best: FloatArray,
    scene: FloatArray,
    rivals: DoubleArray,
    prior: FloatArray,
    inputs: FloatArray,
    first: int,
) -> None:
    """Writes the logits of the rules, and a policy's inputs."""
    known, remembered, state = _ViewRules(*rules.tolist()), PlanMemory(*memory), _Own(*own)
    worth, turns, dangers = best
    angle, offset, _, straightness, is_useful = scene.T
    rows = np.arange(len(worth))
    chosen = worth.argmax(axis=1)
    behind = worth - worth[rows, chosen][:, None]
    is_safe = (dangers[rows, chosen] < known.danger) & (chosen != _BRAKE)
    nitro = (
        is_safe
        & (remembered.nitro_steps == 0)
        & (state.velocity[:, 2] > known.nitro_speed)
        & (np.abs(turns[rows, chosen]) < known.nitro_turn)
        & (np.reshape(state.energy, -1) > 0)
        & ~(state.jumping > 0)
    )
    is_straight = (np.abs(angle) < known.straight_aim) & (straightness < known.straight_angle)
    fire = is_safe & is_straight & (is_useful > 0) & (remembered.since_fire >= known.fire_every)
    offsets, buttons = logits
    prior[:, :_MANEUVERS] = np.maximum(known.worth_scale * behind, known.never)
    prior[:, _MANEUVERS : _MANEUVERS + _OFFSETS] = offsets
    prior[:, -4:-2], prior[:, -2:] = (buttons[own.astype(np.intp)] for own in (nitro, fire))
    if not inputs.shape[1]:
        return
    numbers = inputs[:, first : first + 4 * _MANEUVERS + 3]
    numbers[:, 0:-3:4] = behind > known.never / known.worth_scale * 10
    numbers[:, 1:-3:4] = np.maximum(behind / 10.0, -2.0)
    numbers[:, 2:-3:4] = turns
    numbers[:, 3:-3:4] = np.minimum(dangers / 10.0, 2.0)
    numbers[:, -3], numbers[:, -2], numbers[:, -1] = angle, offset / 10.0, straightness
    is_there, along, across, gain, drift = np.moveaxis(rivals, -1, 0)
    columns = inputs[:, first + numbers.shape[1] :]
    aside = np.where(is_there > 0, across.astype(np.float32) - offset[:, None], 0)
    parts = (is_there, along / 10.0, aside / 3.0, gain.astype("f4") / 5.0, drift.astype("f4") / 3.0)
    for number, part in enumerate(parts):
        columns[:, number : 5 * is_there.shape[1] : 5] = part
