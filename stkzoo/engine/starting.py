"""Puts the karts of a race that has just begun anywhere on the track, at any speed.

The engine can move a kart but not give it speed, and it counts laps by the lines that a kart
crosses. So all karts are led along the road from the start line to their places, high enough
to touch nothing, and set down there. They gain their speed on the spot: a kart that is moved
back after every tick keeps the speed that it has gained. The race clock runs meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.setup import RaceSetup
from stkzoo.errors import ConfigError

FloatArray = npt.NDArray[np.float64]

_TICK = 1 / 120  # of the engine [s]
_STRIDES = (12.0, 9.0, 6.0, 15.0)  # how far karts are led in a tick [m]
_LED_HEIGHTS = (1.0, 0.4)  # above the road; some lines count low karts only [m]
_ITEM_REACH = 2.5  # from the middle of a kart to that of an item that it takes [m]
_BEFORE_LINE = 8.0  # where the way begins [m]
_DROP_HEIGHT = 0.4  # from which karts are set down [m]
_SETTLE_CYCLES = 20
_CYCLE_TICKS = 4  # a kart that is put somewhere in every tick does not fall
_MAX_RUN_TICKS = 600
_ROLLING = 0.01  # this little throttle keeps the game from stopping a kart

#: How bots are turned while they are let down: what they gain one way they lose the other,
#: and tyres hold sideways.
_SPINS = (math.pi / 2, -math.pi / 2, math.pi, 0.0)
_EDGE = 0.5  # half a kart's width [m]

#: How far from its place a kart may end up, along the ground and in height [m].
_REACH = 1.5
_HEIGHT_REACH = 1.3

#: Cosine of the angle by which it may point elsewhere, up and down included.
_FACING = 0.75

#: Top speed at each difficulty [m/s]; the game slows down faster karts.
_TOP_SPEEDS = (15.0, 20.0, 23.0, 25.0)

#: How far from the asked one its speed may be [m/s].
_SPEED_REACH = 1.0


def put_karts(
    race: Any, world: Any, track: Any, setup: RaceSetup, make_action: Callable[[], Any]
) -> None:
    """Moves all karts to ``setup.starts``; call it in phase READY.

    Raises:
        ConfigError: a place is off the road, or a kart does not stay there.
    """
    road = CentreLine(track)
    places = [_Place(road, setup, kart) for kart in range(len(setup.starts))]
    players = [number for number, kart in enumerate(setup.karts) if not kart.is_bot]
    race.config.step_size = _TICK
    mover = _Mover(race, world, {kart: make_action() for kart in players})
    mover.wait_for_go()
    _lead(mover, road, places)
    _set_down(mover, places)
    _run_up(mover, places)
    race.config.step_size = setup.step_size
    _check(mover, places)


class _Place:
    """A kart's start in the world."""

    def __init__(self, road: CentreLine, setup: RaceSetup, kart: int) -> None:
        self.kart, self.start = kart, setup.starts[kart]
        start, top = self.start, _TOP_SPEEDS[setup.difficulty]
        if start.speed > top:
            raise ConfigError(
                f"the start of kart {kart} asks for {start.speed:.1f} m/s, but karts reach "
                f"{top:.0f} m/s at difficulty {setup.difficulty}"
            )
        self.side = ((kart + 0.5) / len(setup.starts) - 0.5) * 3.0
        self.distance = (
            float(start.distance)
            if start.distance is not None
            else float(start.share or 0.0) * road.length
        ) - start.behind
        if not -road.length / 2 < self.distance <= road.length:
            raise ConfigError(
                f"the start of kart {kart} is at {self.distance:.1f} m, expected at most "
                f"{road.length:.1f} m, the length of the lap"
            )
        room = road.half_width(self.distance) - _EDGE
        if abs(start.offset) > room:
            raise ConfigError(
                f"the start of kart {kart} is {start.offset:.1f} m beside the centre line at "
                f"{self.distance:.1f} m, where the road has room for {max(room, 0.0):.1f} m"
            )
        along = road.direction(self.distance)
        yaw = math.atan2(along[0], along[2])
        right = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
        self.point = road.point(self.distance) + start.offset * right
        self.rotation = _rotation_of(
            yaw + start.heading, math.asin(along[1]) * math.cos(start.heading)
        )
        self.stand = self.point
        self.ahead = np.array([math.sin(yaw + start.heading), 0.0, math.cos(yaw + start.heading)])

    def is_near(self, kart: Any) -> bool:
        """Whether a kart of the game stands here."""
        x, y, z = np.asarray(kart.location, np.float64) - self.point
        return math.hypot(x, z) <= _REACH and abs(y) <= _HEIGHT_REACH


class _Mover:
    """Moves karts and the game, tick by tick."""

    def __init__(self, race: Any, world: Any, actions: dict[int, Any]) -> None:
        self.world = world
        self._race, self._actions = race, actions  # of the karts that are no bots
        self._arguments = [list(actions.values())] if actions else []

    def tick(self) -> None:
        self._race.step(*self._arguments)
        self.world.update()

    def put(self, kart: int, point: FloatArray, rotation: list[float], speed: float = 0.0) -> None:
        self.world.set_kart_location(kart, point.tolist(), rotation, speed)

    def throttle(self, kart: int, value: float) -> None:
        if kart in self._actions:
            self._actions[kart].acceleration = value

    def drives(self, kart: int) -> bool:
        """Whether the kart follows our actions; bots do not."""
        return kart in self._actions

    def wait_for_go(self) -> None:
        for _ in range(1000):
            self.tick()
            if str(self.world.phase).endswith(("GO_PHASE", "RACE_PHASE")):
                return


def _lead(mover: _Mover, road: CentreLine, places: list[_Place]) -> None:
    """Leads the karts over the start line and along the road, or to a place before the line."""
    for height in _LED_HEIGHTS:
        distances = [min(-_BEFORE_LINE, place.distance) for place in places]
        is_there = False
        while not is_there:
            is_there = all(d >= p.distance for d, p in zip(distances, places, strict=True))
            for place, distance in zip(places, distances, strict=True):
                along = road.direction(distance)
                rotation = _rotation_of(math.atan2(along[0], along[2]), 0.0)
                mover.put(place.kart, _led_point(road, place, distance, height), rotation)
            mover.tick()
            items = np.array([item.location for item in mover.world.items], np.float64)
            distances = [
                _next(road, place, distance, height, items.reshape(-1, 3))
                for place, distance in zip(places, distances, strict=True)
            ]
        if all(mover.world.karts[p.kart].finished_laps >= 0 for p in places if p.distance > 1.0):
            return


def _next(
    road: CentreLine, place: _Place, distance: float, height: float, items: FloatArray
) -> float:
    """The distance of a kart in the next tick, where it touches no item [m]."""
    for stride in _STRIDES:
        ahead = min(distance + stride, place.distance)
        point = _led_point(road, place, ahead, height)
        if (np.linalg.norm(items - point, axis=1) > _ITEM_REACH).all():
            return ahead
    return min(distance + _STRIDES[0], place.distance)


def _led_point(road: CentreLine, place: _Place, distance: float, height: float) -> FloatArray:
    """A point above the road, with a little room between the karts."""
    along = road.direction(distance)
    right = np.array([along[2], 0.0, -along[0]])
    point: FloatArray = road.point(distance) + place.side * right
    point[1] += height
    return point


def _set_down(mover: _Mover, places: list[_Place]) -> None:
    """Sets the karts down on the road, at rest, and records how they stand there."""
    for place in places:
        place.stand = place.point + np.array([0.0, _DROP_HEIGHT, 0.0])
    for cycle in range(_SETTLE_CYCLES):
        for place in places:
            turn = 0.0 if mover.drives(place.kart) else _SPINS[cycle % len(_SPINS)]
            mover.put(place.kart, place.stand, _turned(place.rotation, turn))
        for _ in range(_CYCLE_TICKS):
            mover.tick()
        for place in places:
            height = float(mover.world.karts[place.kart].location[1])
            place.stand = np.array([place.point[0], height, place.point[2]])
    for place in places:
        kart = mover.world.karts[place.kart]
        if not place.is_near(kart):
            raise _no_ground(place)
        if mover.drives(place.kart):
            w, x, y, z = map(float, kart.rotation)
            place.rotation = [-x, -y, -z, w]  # the game reads it as world to kart


def _run_up(mover: _Mover, places: list[_Place]) -> None:
    """Makes the karts gain speed on the spot, and releases them."""
    if not any(place.start.speed for place in places):
        return
    for _ in range(_MAX_RUN_TICKS):
        if not any(_lacks(mover, place) > 0 for place in places if mover.drives(place.kart)):
            break
        for place in places:
            is_slow = _lacks(mover, place) > 0
            mover.throttle(place.kart, 1.0 if is_slow else _ROLLING if place.start.speed else 0.0)
            # A bot does not follow us; turned round it slows down as hard.
            turn = 0.0 if is_slow or mover.drives(place.kart) else math.pi
            speed = place.start.speed
            mover.put(place.kart, place.stand, _turned(place.rotation, turn), speed)
        mover.tick()
    for place in places:
        mover.throttle(place.kart, 0.0)
        mover.put(place.kart, place.stand, place.rotation, place.start.speed)


def _lacks(mover: _Mover, place: _Place) -> float:
    velocity = np.asarray(mover.world.karts[place.kart].velocity, np.float64)
    return place.start.speed - float(velocity @ place.ahead) - 0.02


def _check(mover: _Mover, places: list[_Place]) -> None:
    mover.world.update()  # karts have been turned since
    for place in places:
        kart = mover.world.karts[place.kart]
        nose = np.asarray(kart.front, np.float64) - np.asarray(kart.location, np.float64)
        faces_ahead = nose @ place.ahead >= _FACING * np.linalg.norm(nose)
        if not faces_ahead or not place.is_near(kart):
            raise _no_ground(place)
        if place.distance > 1.0 and kart.finished_laps != 0:
            raise ConfigError(
                f"kart {place.kart} cannot start at {place.distance:.1f} m: the game counts no lap "
                "there; choose a place some metres before or after it"
            )
        if mover.drives(place.kart) and abs(_lacks(mover, place)) > _SPEED_REACH:
            raise ConfigError(
                f"kart {place.kart} cannot start at {place.distance:.1f} m with "
                f"{place.start.speed:.1f} m/s: the road there does not allow it; choose another "
                "place or speed"
            )


def _no_ground(place: _Place) -> ConfigError:
    return ConfigError(
        f"kart {place.kart} cannot start at {place.distance:.1f} m: there is no road to stand on; "
        "choose a place some metres before or after it"
    )


class CentreLine:
    """The track's main line as a curve over the distance from the start line.

    Attributes:
        length: of a lap [m].

    Args:
        track: the engine's track.
    """

    def __init__(self, track: Any) -> None:
        self.length = float(track.length)
        nodes = np.asarray(track.path_nodes, np.float64)
        marks = np.asarray(track.path_distance, np.float64)
        widths = np.asarray(track.path_width, np.float64).reshape(-1)
        chain = _main_line(track.successors)
        order = np.argsort(marks[chain].ravel(), kind="stable")
        self._marks = marks[chain].ravel()[order]
        self._points = nodes[chain].reshape(-1, 3)[order]
        self._half_widths = np.repeat(widths[chain] / 2, 2)[order]

    def point(self, distance: float) -> FloatArray:
        """The centre line ``(3,)`` [m] at a distance [m]."""
        mark = distance % self.length
        return np.array([np.interp(mark, self._marks, column) for column in self._points.T])

    def half_width(self, distance: float) -> float:
        """From the centre line to the road's edge [m]."""
        return float(np.interp(distance % self.length, self._marks, self._half_widths))

    def direction(self, distance: float) -> FloatArray:
        """Where the road leads, a unit vector ``(3,)``."""
        mark = distance % self.length
        row = int(np.clip(np.searchsorted(self._marks, mark, "right"), 1, len(self._marks) - 1))
        while row > 1 and np.linalg.norm(self._points[row] - self._points[row - 1]) < 0.05:
            row -= 1
        along: FloatArray = self._points[row] - self._points[row - 1]
        unit: FloatArray = along / max(float(np.linalg.norm(along)), 1e-9)
        return unit


def _main_line(successors: Any) -> list[int]:
    """The nodes of the main road, from the start line on."""
    chain, node = [], 0
    while node not in chain:
        chain.append(node)
        node = successors[node][0]
    return chain


def _rotation_of(yaw: float, climb: float) -> list[float]:
    """The quaternion x, y, z, w of a turn to ``yaw`` and then the nose up by ``climb``."""
    sy, cy = math.sin(yaw / 2), math.cos(yaw / 2)
    sp, cp = math.sin(-climb / 2), math.cos(-climb / 2)
    return [cy * sp, sy * cp, -sy * sp, cy * cp]


def _turned(rotation: list[float], angle: float) -> list[float]:
    """A rotation after a turn about the kart's own upright axis."""
    x, y, z, w = rotation
    s, c = math.sin(angle / 2), math.cos(angle / 2)
    return [x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s]
