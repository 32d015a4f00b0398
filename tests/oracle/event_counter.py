"""The NumPy implementation of ``event_counter.c``."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.mdp.geometry import rotation_matrices
from stkzoo.names import AttachmentType, ItemType, PowerupType

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

#: The columns of ``counts``.
_KART_CONTACT, _WALL_CONTACT, _HIT, _ITEM_TAKEN, _ITEM_USED = range(5)
_OVERTAKE, _OVERTAKEN, _RESCUE, _OFF_ROAD, _WRONG_WAY = range(5, 10)
#: The first columns of ``memory``. The place has three columns. A column for each kart follows.
_OFF_ROAD_FOR, _WRONG_WAY_FOR, _STUCK_FOR, _PLACE, _IS_CARRIED, _WALL_FOR, _NUM_OWN = (
    *range(4),
    *(6, 7, 8),
)
#: Thresholds, explained in ``event_counter.c``.
_APART, _TOUCH, _NEAR, _STUCK, _BACKWARDS, _NITRO = 0.5, 0.1, 0.25, 3.0, 1.0, 0.4
_CANNON, _TUMBLE, _GUM_REACH = 15.0, 1.7, 3.0
_FORWARDS, _LOSS, _BRAKES, _DRAG = 2.0, 4.5, 40.0, 2.0
#: When the boxes of two karts are compared, as fractions of a step: after the first snapshot and
#: before the second one.
_WHEN = (0.0, 0.25, 0.5)


class EventCounter:
    def __init__(
        self,
        nodes: npt.NDArray[np.float32],
        step_size: float,
        memory: FloatArray,
        counts: FloatArray,
    ) -> None:
        self._road, self._dt = nodes[:, 1].astype(np.float64) - nodes[:, 0], step_size
        self._memory, self._counts = memory, counts

    def count(self, before: bytes, after: bytes) -> None:
        then, now = Snapshot(before), Snapshot(after)
        self._counts[:] = 0.0
        if now.header["time"] > then.header["time"]:
            self._time_karts(then, now)
            self._count_ranks(then.karts, now.karts)
            self._count_items(then, now)
            self._count_rides(then.karts, now.karts)
            self._count_contacts(then.karts, now.karts)

    def _time_karts(self, then: Snapshot, now: Snapshot) -> None:
        karts, memory, dt = now.karts, self._memory, self._dt
        road = self._road[karts["node"]]
        along = (road * karts["velocity"]).sum(1)
        is_back = (along < -_BACKWARDS * np.sqrt((road * road).sum(1))) & (karts["speed"] != 0)
        is_off = karts["is_on_road"] == 0
        self._counts[:, _OFF_ROAD], self._counts[:, _WRONG_WAY] = dt * is_off, dt * is_back
        place = memory[:, _PLACE : _PLACE + 3]
        np.copyto(place, then.karts["location"], where=np.isinf(place))  # the first step
        has_moved = ((karts["location"] - place) ** 2).sum(1) > _STUCK**2
        place[has_moved] = karts["location"][has_moved]
        for column, goes_on in ((0, is_off), (1, is_back), (2, ~has_moved)):
            memory[:, column] = np.where(goes_on, memory[:, column] + dt, 0.0)

    def _count_ranks(self, then: Any, now: Any) -> None:
        old, new = then["position"], now["position"]
        races = then["has_finished_race"] == 0
        passes = (old[:, None] > old) & (new[:, None] < new) & races[:, None] & races
        self._counts[:, _OVERTAKE], self._counts[:, _OVERTAKEN] = passes.sum(1), passes.sum(0)

    def _count_items(self, then: Snapshot, now: Snapshot) -> None:
        old, new = then.karts, now.karts
        number, before = new["powerup_num"], old["powerup_num"]
        has_more = (number > before) | ((number > 0) & (new["powerup_type"] != old["powerup_type"]))
        has_more &= new["powerup_type"] != PowerupType.NOTHING
        has_nitro = new["energy"] > old["energy"] + np.float32(_NITRO)
        self._counts[:, _ITEM_TAKEN] = has_more.astype(np.float64) + has_nitro
        self._counts[:, _ITEM_USED] = (number < before) & ~has_more
        hung = new["attachment_type"]
        burdens = AttachmentType.PARACHUTE, AttachmentType.ANVIL, AttachmentType.BOMB
        self._counts[:, _HIT] += (hung != old["attachment_type"]) & np.isin(hung, burdens)
        left = set(now.items["id"].tolist())
        for item in then.items[then.items["type"] == ItemType.BUBBLEGUM]:
            apart = ((new["location"] - item["location"]).astype(np.float64) ** 2).sum(1)
            nearest = apart.argmin()
            if int(item["id"]) not in left and apart[nearest] < _GUM_REACH**2:
                self._counts[nearest, _HIT] += new["attachment_type"][nearest] != (
                    AttachmentType.BUBBLEGUM_SHIELD
                )

    def _count_rides(self, then: Any, now: Any) -> None:
        """Counts rescues and explosions, but not cannons. A carried kart keeps its velocity."""
        way = now["location"].astype(np.float64) - then["location"]
        far = np.sqrt((way * way).sum(1))
        is_carried = (now["velocity"] == then["velocity"]).all(1) & (far > 0)
        begins = is_carried & (self._memory[:, _IS_CARRIED] == 0) & (far < _CANNON * self._dt)
        products = now["rotation"].astype(np.float64) * then["rotation"]
        turn = 2.0 * np.arccos(np.minimum(np.abs(products.sum(1)), 1.0))
        tumbles = turn > _TUMBLE * self._dt
        self._counts[:, _HIT] += begins & tumbles
        self._counts[:, _RESCUE] = begins & ~tumbles
        self._memory[:, _IS_CARRIED] = is_carried

    def _count_contacts(self, then: Any, now: Any) -> None:
        memory, dt = self._memory, self._dt
        gaps = np.minimum(self._gaps(then, dt), self._gaps(now, -dt))
        is_flying = _is_carried(then) | _is_carried(now)
        gaps[is_flying] = gaps[:, is_flying] = np.inf
        is_touched = gaps <= _TOUCH
        since = memory[:, _NUM_OWN:]
        self._counts[:, _KART_CONTACT] = (is_touched & (since <= 0)).sum(1)
        since[:] = np.where(is_touched, _APART, since - dt)
        np.fill_diagonal(since, 0.0)
        is_flying |= memory[:, _IS_CARRIED] > 0
        is_bumped = (gaps <= _NEAR).any(1) | (self._counts[:, _HIT] > 0) | is_flying
        bumps = self._bumps(then, now) & ~is_bumped
        self._counts[:, _WALL_CONTACT] = bumps & (memory[:, _WALL_FOR] <= 0)
        memory[:, _WALL_FOR] = np.where(bumps | is_flying, _APART, memory[:, _WALL_FOR] - dt)

    def _bumps(self, then: Any, now: Any) -> BoolArray:
        """Returns which karts lose more speed than brakes or the ground can take.

        Landings do not count: they change the vertical velocity even more.
        """
        old, new = then["velocity"].astype(np.float64), now["velocity"].astype(np.float64)
        axes = rotation_matrices(then["rotation"].astype(np.float64))
        forwards, change = (axes[:, 2] * old).sum(1), new - old
        speed = np.hypot(old[:, 0], old[:, 2]) + 1e-9
        loss = -(change[:, 0] * old[:, 0] + change[:, 2] * old[:, 2]) / speed
        is_dragged = now["attachment_type"] == AttachmentType.PARACHUTE
        limit = max(_LOSS, _BRAKES * self._dt) * np.where(is_dragged, _DRAG, 1.0)
        bumps: BoolArray = (forwards > _FORWARDS) & (loss > limit) & (change[:, 1] <= loss)
        return bumps

    def _gaps(self, karts: Any, ahead: float) -> FloatArray:
        """Returns the least distances of karts' boxes, ``(K, K)`` [m].

        Args:
            karts: records of the karts.
            ahead: length of a step [s], negative to go back in time; distances are taken over half
                of it.
        """
        axes = rotation_matrices(karts["rotation"].astype(np.float64))
        reach = karts["size"].astype(np.float64) / 2.0
        places, velocities = (karts[name].astype(np.float64) for name in ("location", "velocity"))
        heights = reach[:, None, 1] + reach[None, :, 1]
        least = np.full((len(karts), len(karts)), np.inf)
        for share in _WHEN:
            where = places + share * ahead * velocities
            ways = where[None] - where[:, None]  # from the first kart to the second
            gap = np.abs((axes[:, None, 1] * ways).sum(-1)) - heights
            gap = np.maximum(gap, gap.T)
            for axis in (0, 2):
                along = axes[:, axis]  # (K, 3), of the first kart
                own = reach[:, None, axis]
                sides = np.abs(np.einsum("ic,jac->ija", along, axes[:, ::2]))
                others = (sides * reach[None, :, ::2]).sum(-1)
                part = np.abs((along[:, None] * ways).sum(-1)) - own - others
                gap = np.maximum(gap, np.maximum(part, part.T))
            least = np.minimum(least, gap)
        np.fill_diagonal(least, np.inf)
        return least


def _is_carried(karts: Any) -> BoolArray:
    """Returns which karts a rescue, an explosion or a cannon carries: their speed is 0."""
    is_carried: BoolArray = (karts["speed"] == 0) & (np.abs(karts["velocity"]).sum(1) > 0.3)
    return is_carried
