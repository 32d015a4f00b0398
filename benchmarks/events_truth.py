"""Derives the events of a recorded race from its trajectories at 120 Hz.

This module shares no code with the counter and has twelve times as much data: the position of every
kart in every physics tick, including later ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.events_races import RATE, TICKS, Recording

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

#: Contacts at most this far apart count as one [ticks].
_APART = RATE // 2
#: Points on a kart's outline, as fractions of its half width and half length.
_SIDE = np.linspace(-1.0, 1.0, 13)
_OUTLINE = np.array(
    [(x, z) for x in _SIDE for z in (-1.0, 1.0)] + [(x, z) for z in _SIDE for x in (-1.0, 1.0)]
)


class Trajectories:
    """A recorded race, as arrays over ticks and karts.

    Args:
        race: the recording; moments before GO are dropped.
    """

    def __init__(self, race: Recording) -> None:
        begin = next(n for n, moment in enumerate(race.moments) if moment.header["time"] > 0) - 1
        begin -= begin % TICKS
        self.moments = race.moments[begin:]
        self.track = race.track
        self.karts = np.stack([moment.karts for moment in self.moments])
        self.place = self.karts["location"].astype(np.float64)
        self.speed = self.karts["velocity"].astype(np.float64)
        self.axes = axes_of(self.karts["rotation"])
        self.num_kart = self.karts.shape[1]
        self.rides = [self._rides(kart) for kart in range(self.num_kart)]
        self.is_riding = np.zeros(self.karts.shape, np.bool_)
        for kart, rides in enumerate(self.rides):
            for first, last, _ in rides:
                self.is_riding[first : last + 1, kart] = True
        self.gaps = {
            (one, other): self._gap(one, other)
            for one in range(self.num_kart)
            for other in range(one)
        }

    def _rides(self, kart: int) -> list[tuple[int, int, str]]:
        """Returns the first and last ticks of each scripted motion of a kart, and its kind.

        In a scripted motion, the kart moves while its velocity stays constant, bit for bit. A
        rescue moves it far in one tick, an explosion turns it over, and a cannon does neither.
        """
        still = (np.diff(self.speed[:, kart], axis=0) == 0).all(1)
        moves = np.linalg.norm(np.diff(self.place[:, kart], axis=0), axis=1)
        rides = []
        for first, last in runs(np.flatnonzero(still & (moves > 0)), 2):
            if last - first < RATE // 3:
                continue
            jump, usual = moves[first : last + 2].max(), np.median(moves[first : last + 1])
            tilt = (self.axes[first : last + 1, kart, 1] @ self.axes[first, kart, 1]).min()
            kind = "rescue" if jump > 1.0 and usual < 0.12 else "hit" if tilt < 0.8 else "other"
            rides.append((first, last + 1, kind))
        return rides

    def _gap(self, one: int, other: int) -> FloatArray:
        """Returns the gap of two karts in each tick [m]; infinite if far or in scripted motion."""
        gaps = np.full(len(self.karts), np.inf)
        away = np.linalg.norm(self.place[:, one] - self.place[:, other], axis=1)
        near = np.flatnonzero((away < 4.0) & ~self.is_riding[:, [one, other]].any(1))
        if len(near):
            gaps[near] = gap_of(self.karts[near, one], self.karts[near, other])
        return gaps


def axes_of(rotation: npt.NDArray[Any]) -> FloatArray:
    """Returns the right, up and forward axes ``(..., 3, 3)`` for quaternions w, x, y, z."""
    w, x, y, z = np.moveaxis(rotation.astype(np.float64), -1, 0)
    right = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1)
    forward = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)
    return np.stack([right, np.cross(forward, right), forward], -2)


def gap_of(first: npt.NDArray[Any], second: npt.NDArray[Any]) -> FloatArray:
    """Returns the distance ``(T,)`` of a kart's outline from another's box [m]; 0 if inside.

    Args:
        first: ``(T,)`` records of a kart.
        second: ``(T,)`` records of another kart.
    """
    gaps = []
    for one, other in ((first, second), (second, first)):
        axes, seen_by = axes_of(one["rotation"]), axes_of(other["rotation"])
        half, size = one["size"] / 2.0, other["size"] / 2.0
        points = one["location"][:, None] + sum(
            (_OUTLINE[:, part] * half[:, axis, None])[..., None] * axes[:, None, axis]
            for part, axis in ((0, 0), (1, 2))
        )
        away = points - other["location"][:, None]
        beside = np.abs(np.einsum("tpc,tac->tpa", away, seen_by)) - size[:, None]
        beside[..., 1] -= half[:, None, 1]
        gaps.append(np.linalg.norm(np.maximum(beside, 0.0), axis=-1).min(1))
    return np.minimum(*gaps)


def runs(ticks: npt.NDArray[np.intp], apart: int) -> list[tuple[int, int]]:
    """Groups ticks that are at most ``apart`` apart; returns each group's first and last tick."""
    if not len(ticks):
        return []
    breaks = np.flatnonzero(np.diff(ticks) > apart)
    firsts = ticks[np.r_[0, breaks + 1]]
    return list(zip(firsts.tolist(), ticks[np.r_[breaks, -1]].tolist(), strict=True))


def kart_contacts(race: Trajectories) -> FloatArray:
    """Counts contacts: runs of ticks in which a kart's outline is within 5 cm of another kart."""
    counts = np.zeros(race.num_kart)
    for pair, gaps in race.gaps.items():
        counts[list(pair)] += len(runs(np.flatnonzero(gaps <= 0.05), _APART))
    return counts


def wall_contacts(race: Trajectories) -> FloatArray:
    """Counts ticks in which a kart loses over 1 m/s, and over 5 m/s within 0.1 s.

    The kart must drive forward, without another kart nearby, without a scripted motion in the last
    0.5 s, and without a landing, which changes the vertical speed more than the forward speed.
    """
    counts = np.zeros(race.num_kart)
    window = TICKS
    for kart in range(race.num_kart):
        flat = race.speed[:, kart][:, [0, 2]]
        ahead = flat / (np.linalg.norm(flat, axis=1, keepdims=True) + 1e-9)
        blow = -(np.diff(flat, axis=0) * ahead[:-1]).sum(1)
        forwards = (race.speed[:, kart] * race.axes[:, kart, 2]).sum(1)
        far = [np.full(len(flat), np.inf)]
        near = np.min(far + [gaps for pair, gaps in race.gaps.items() if kart in pair], 0)
        found = []
        for tick in np.flatnonzero((blow > 1.0) & (forwards[:-1] > 2.0)):
            last = min(tick + window, len(flat) - 1)
            here = slice(max(tick - window, 0), last + 1)
            cost = ((flat[tick] - flat[tick : last + 1]) @ ahead[tick]).max()
            up = np.ptp(race.speed[max(tick - 2, 0) : tick + 4, kart, 1])
            is_set_down = race.is_riding[max(tick - _APART, 0) : last + 1, kart].any()
            is_free = not is_set_down and near[here].min() > 0.25
            if cost > 5.0 and up <= cost and is_free and not _is_burdened(race, kart, here):
                found.append(tick)
        counts[kart] = len(runs(np.array(found, np.intp), _APART))
    return counts


def _is_burdened(race: Trajectories, kart: int, ticks: slice) -> bool:
    """Returns whether a kart gets or loses a parachute or an anvil in these ticks."""
    kinds = race.karts["attachment_type"][ticks, kart]
    return bool((kinds != kinds[0]).any() and np.isin(kinds, (0, 1)).any())


def hits(race: Trajectories) -> FloatArray:
    """Counts explosions that turn a kart over, harmful attachments, and bubble gum driven into."""
    counts = np.zeros(race.num_kart)
    for kart in range(race.num_kart):
        counts[kart] += sum(kind == "hit" for _, _, kind in race.rides[kart])
        burden = race.karts["attachment_type"][:, kart]
        counts[kart] += ((burden[1:] != burden[:-1]) & np.isin(burden[1:], (0, 1, 2))).sum()
    for tick, (now, then) in enumerate(zip(race.moments[1:], race.moments, strict=False)):
        if len(now.items) == len(then.items):
            continue
        for item in then.items[~np.isin(then.items["id"], now.items["id"])]:
            away = np.linalg.norm(race.place[tick] - item["location"], axis=1)
            kart = int(away.argmin())
            is_gum = item["type"] == 4 and away[kart] < 1.5
            counts[kart] += is_gum and race.karts["attachment_type"][tick, kart] != 6
    return counts


def items_taken(race: Trajectories) -> FloatArray:
    """Counts ticks after which a kart near a box or bottle has more powerups, another, or nitro."""
    counts = np.zeros(race.num_kart)
    for kart in range(race.num_kart):
        number = race.karts["powerup_num"][:, kart]
        kind = race.karts["powerup_type"][:, kart]
        energy = race.karts["energy"][:, kart]
        gets_box = (number[1:] > 0) & ((number[1:] > number[:-1]) | (kind[1:] != kind[:-1]))
        gets_nitro = energy[1:] > energy[:-1] + 0.5
        for gets, kinds in ((gets_box & (kind[1:] != 0), (0,)), (gets_nitro, (2, 3))):
            for tick in np.flatnonzero(gets):
                items = race.moments[tick].items
                items = items[np.isin(items["type"], kinds)]
                away = np.linalg.norm(items["location"] - race.place[tick, kart], axis=1)
                counts[kart] += len(items) > 0 and away.min() < 2.5
    return counts


def items_used(race: Trajectories) -> FloatArray:
    """Counts ticks in which a kart's number of powerups decreases."""
    return (np.diff(race.karts["powerup_num"], axis=0) < 0).sum(0).astype(np.float64)


def overtakes(race: Trajectories) -> tuple[FloatArray, FloatArray]:
    """Counts overtakes made and suffered, by laps and meters, until one kart finishes."""
    karts = race.karts[::TICKS]
    far = karts["finished_laps"] * race.track.length + karts["distance_down_track"]
    far = np.where(karts["finished_laps"] < 0, -1.0 - np.arange(race.num_kart), far)  # on the grid
    ended = race.karts["has_finished_race"][::TICKS] > 0
    made, suffered = np.zeros(race.num_kart), np.zeros(race.num_kart)
    for one in range(race.num_kart):
        for other in range(race.num_kart):
            ahead = far[:, one] > far[:, other]
            passes = ~ahead[:-1] & ahead[1:] & ~ended[:-1, one] & ~ended[:-1, other]
            made[one] += passes.sum()
            suffered[other] += passes.sum()
    return made, suffered


def rescues(race: Trajectories) -> FloatArray:
    """Counts scripted motions that are rescues."""
    kinds = [[kind for _, _, kind in rides] for rides in race.rides]
    return np.array([own.count("rescue") for own in kinds], np.float64)


def off_road(race: Trajectories) -> FloatArray:
    """Returns the time that each kart spends outside all track segments [s]."""
    _, beside, beyond = _on_track(race)
    half = race.track.path_width[:, 0] / 2.0
    is_off = ~((beside < half) & (beyond <= 0.0)).any(-1)
    return is_off.sum(0) * TICKS / RATE


def wrong_way(race: Trajectories) -> FloatArray:
    """Returns the time at more than 1 m/s against the direction of the nearest segment [s]."""
    nearest = _on_track(race)[0].argmin(-1)[1:]
    begin, end = race.track.path_nodes.astype(np.float64).swapaxes(0, 1)
    along = (end - begin) / (np.linalg.norm(end - begin, axis=1, keepdims=True) + 1e-9)
    way = (np.diff(race.place[::TICKS], axis=0) * along[nearest]).sum(-1) * RATE / TICKS
    return ((way < -1.0) & ~race.is_riding[TICKS::TICKS]).sum(0) * TICKS / RATE


def _on_track(race: Trajectories) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Locates karts relative to each segment, ten times per second.

    Returns:
        Distance from the segment's center line, lateral distance, and distance beyond its ends,
        each ``(T, K, N)`` [m].
    """
    begin, end = race.track.path_nodes.astype(np.float64).swapaxes(0, 1)
    length = np.linalg.norm(end - begin, axis=1) + 1e-9
    along = (end - begin) / length[:, None]
    way = race.place[::TICKS, :, None] - begin
    share = (way * along).sum(-1)
    inside = np.clip(share, 0.0, length)
    away = np.linalg.norm(way - inside[..., None] * along, axis=-1)
    beside = np.abs(way[..., 0] * along[:, 2] - way[..., 2] * along[:, 0])
    beyond = np.where(np.abs(way[..., 1]) > 6.0, np.inf, np.abs(share - inside))
    return away, beside, beyond


def truth_of(recording: Recording) -> dict[str, FloatArray]:
    """Returns the true counts ``(K,)`` by event."""
    race = Trajectories(recording)
    made, suffered = overtakes(race)
    single: dict[str, Callable[[Trajectories], FloatArray]] = {
        "kart_contact": kart_contacts,
        "wall_contact": wall_contacts,
        "hit": hits,
        "item_taken": items_taken,
        "item_used": items_used,
        "rescue": rescues,
        "off_road": off_road,
        "wrong_way": wrong_way,
    }
    found = {name: function(race) for name, function in single.items()}
    return found | {"overtake": made, "overtaken": suffered}
