"""Custom starts: places karts anywhere on the track, at any speed, when a race begins.

The engine can move a kart but cannot set its speed, and it counts laps from the lines that a kart
crosses. So all karts are moved along the road from the start line to their places, high enough
to touch nothing, and lowered there. Then they accelerate without leaving their places: a kart
that is moved back after every tick keeps the speed that it gained. The race clock runs during all
of this.
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

#: Physics tick of the engine [s].
TICK = 1 / 120
_STRIDES = (12.0, 9.0, 6.0, 15.0)  # distances to move karts along the road per tick [m]
_LED_HEIGHTS = (1.0, 0.4)  # above the road [m]; some lines only count low karts
_ITEM_REACH = 2.5  # distance between the centers of a kart and an item at which it takes it [m]
_BEFORE_LINE = 8.0  # where the movement begins, before the start line [m]
_DROP_HEIGHT = 0.4  # initial height for lowering a kart [m]
_SETTLE_CYCLES = 20
_CYCLE_TICKS = 4  # more than one, because a kart that is placed in every tick does not fall
_MAX_RUN_TICKS = 600
_ROLLING = 0.01  # minimum throttle with which the game does not stop a kart

#: Turns of bots while they are lowered [rad]. Speed gained in one direction is lost in the
#: opposite one, and tires prevent sideways movement.
_SPINS = (math.pi / 2, -math.pi / 2, math.pi, 0.0)
_EDGE = 0.5  # half a kart's width [m]

#: Maximum distance between a kart and its place, horizontal and vertical [m].
_REACH = 1.5
_HEIGHT_REACH = 1.3

#: Cosine of the maximum angle between a kart's direction and its heading, including the slope.
_FACING = 0.75

#: Top speed at each difficulty [m/s]; the game slows down faster karts.
_TOP_SPEEDS = (15.0, 20.0, 23.0, 25.0)

#: Maximum difference between a kart's speed and the requested speed [m/s].
_SPEED_REACH = 1.0


def put_karts(
    race: Any, world: Any, track: Any, setup: RaceSetup, make_action: Callable[[], Any]
) -> None:
    """Moves all karts to ``setup.starts``. Call it in the phase READY.

    Args:
        race: the engine's race.
        world: the engine's world state.
        track: the engine's track.
        setup: options of the race.
        make_action: creates an action of the engine.

    Raises:
        ConfigError: a kart cannot start at its place, with its heading or at its speed.
    """
    road = CenterLine(track)
    places = [_Place(road, setup, kart) for kart in range(len(setup.starts))]
    players = [number for number, kart in enumerate(setup.karts) if not kart.is_bot]
    race.config.step_size = TICK
    mover = _Mover(race, world, {kart: make_action() for kart in players})
    mover.wait_for_go()
    _lead(mover, road, places)
    _set_down(mover, places)
    _run_up(mover, places)
    race.config.step_size = setup.step_size
    _check(mover, places)


class _Place:
    """The place of a kart's start in the world frame.

    Attributes:
        led: how far along the road the kart is on the way to its place [m].

    Raises:
        ConfigError: the start is off the road or beyond the lap, or its speed is too high.
    """

    def __init__(self, road: CenterLine, setup: RaceSetup, kart: int) -> None:
        self.kart, self.start = kart, setup.starts[kart]
        start, top = self.start, _TOP_SPEEDS[setup.difficulty]
        if start.speed > top:
            raise ConfigError(
                f"the start of kart {kart} asks for {start.speed:.1f} m/s, but karts reach "
                f"{top:.0f} m/s at difficulty {setup.difficulty}"
            )
        self.side = ((kart + 0.5) / len(setup.starts) - 0.5) * 3.0
        share = float(start.share or 0.0)
        place = share * road.length if start.distance is None else float(start.distance)
        self.distance = self.led = place - start.behind
        if not -road.length / 2 < self.distance <= road.length:
            raise ConfigError(
                f"the start of kart {kart} is at {self.distance:.1f} m, expected at most "
                f"{road.length:.1f} m, the length of the lap"
            )
        room = road.half_width(self.distance) - _EDGE
        if abs(start.offset) > room:
            raise ConfigError(
                f"the start of kart {kart} is {start.offset:.1f} m from the center line at "
                f"{self.distance:.1f} m, where the road has room for {max(room, 0.0):.1f} m"
            )
        along = road.direction(self.distance)
        yaw = math.atan2(along[0], along[2])
        right = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
        self.point = road.point(self.distance) + start.offset * right
        heading = yaw + start.heading
        self.rotation = _rotation_of(heading, math.asin(along[1]) * math.cos(start.heading))
        self.stand = self.point
        self.ahead = np.array([math.sin(heading), 0.0, math.cos(heading)])

    def is_near(self, kart: Any) -> bool:
        """Returns whether a kart of the engine is at this place."""
        x, y, z = np.asarray(kart.location, np.float64) - self.point
        return math.hypot(x, z) <= _REACH and abs(y) <= _HEIGHT_REACH


class _Mover:
    """Moves karts and advances the game, tick by tick."""

    def __init__(self, race: Any, world: Any, actions: dict[int, Any]) -> None:
        self.world = world
        self._race, self._actions = race, actions  # actions of the karts that are not bots
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
        """Returns whether the kart follows actions; bots do not."""
        return kart in self._actions

    def wait_for_go(self) -> None:
        for _ in range(1000):
            self.tick()
            if str(self.world.phase).endswith(("GO_PHASE", "RACE_PHASE")):
                return


def _lead(mover: _Mover, road: CenterLine, places: list[_Place]) -> None:
    """Moves the karts along the road, above the ground, to the distances of their places.

    If a kart whose place is after the start line has not crossed it, all karts are moved again,
    lower.
    """
    for height in _LED_HEIGHTS:
        for place in places:
            place.led = min(-_BEFORE_LINE, place.distance)
        is_there = False
        while not is_there:
            is_there = all(place.led >= place.distance for place in places)
            for place in places:
                along = road.direction(place.led)
                rotation = _rotation_of(math.atan2(along[0], along[2]), 0.0)
                mover.put(place.kart, _led_point(road, place, place.led, height), rotation)
            mover.tick()
            items = np.array([item.location for item in mover.world.items], np.float64)
            for place in places:
                place.led = _next(road, place, height, items.reshape(-1, 3))
        if all(mover.world.karts[p.kart].finished_laps >= 0 for p in places if p.distance > 1.0):
            return


def _next(road: CenterLine, place: _Place, height: float, items: FloatArray) -> float:
    """Returns the distance of a kart in the next tick [m], if possible one without items."""
    for stride in _STRIDES:
        ahead = min(place.led + stride, place.distance)
        point = _led_point(road, place, ahead, height)
        if (np.linalg.norm(items - point, axis=1) > _ITEM_REACH).all():
            return ahead
    return min(place.led + _STRIDES[0], place.distance)


def _led_point(road: CenterLine, place: _Place, distance: float, height: float) -> FloatArray:
    """Returns a kart's point above the road, beside the points of the other karts."""
    along = road.direction(distance)
    right = np.array([along[2], 0.0, -along[0]])
    point: FloatArray = road.point(distance) + place.side * right
    point[1] += height
    return point


def _set_down(mover: _Mover, places: list[_Place]) -> None:
    """Lowers the karts to the road, at rest, and stores their height and rotation there.

    Raises:
        ConfigError: a kart does not stay at its place.
    """
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
            place.rotation = [-x, -y, -z, w]  # the engine expects world to kart


def _run_up(mover: _Mover, places: list[_Place]) -> None:
    """Accelerates the karts at their places, then releases them."""
    if not any(place.start.speed for place in places):
        return
    for _ in range(_MAX_RUN_TICKS):
        if not any(_lacks(mover, place) > 0 for place in places if mover.drives(place.kart)):
            break
        for place in places:
            is_slow = _lacks(mover, place) > 0
            mover.throttle(place.kart, 1.0 if is_slow else _ROLLING if place.start.speed else 0.0)
            # A bot chooses its own throttle. When it is turned around, it slows down as fast.
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
    mover.world.update()  # karts were turned after the last update
    for place in places:
        kart = mover.world.karts[place.kart]
        nose = np.asarray(kart.front, np.float64) - np.asarray(kart.location, np.float64)
        faces_ahead = nose @ place.ahead >= _FACING * np.linalg.norm(nose)
        if not faces_ahead or not place.is_near(kart):
            raise _no_ground(place)
        if place.distance > 1.0 and kart.finished_laps != 0:
            raise ConfigError(
                f"kart {place.kart} cannot start at {place.distance:.1f} m: the game counts no lap "
                "there; choose a place some meters before or after it"
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
        "choose a place some meters before or after it"
    )


class CenterLine:
    """The center line of the track's main road, as a function of the distance along it.

    Distances start at the start line and wrap around at the length of the lap.

    Attributes:
        length: length of a lap [m].

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
        """Returns the point ``(3,)`` of the center line at a distance [m], world frame."""
        mark = distance % self.length
        return np.array([np.interp(mark, self._marks, column) for column in self._points.T])

    def half_width(self, distance: float) -> float:
        """Returns the distance from the center line to the road's edge [m]."""
        return float(np.interp(distance % self.length, self._marks, self._half_widths))

    def direction(self, distance: float) -> FloatArray:
        """Returns the direction of the road at a distance, a unit vector ``(3,)``."""
        mark = distance % self.length
        row = int(np.clip(np.searchsorted(self._marks, mark, "right"), 1, len(self._marks) - 1))
        while row > 1 and np.linalg.norm(self._points[row] - self._points[row - 1]) < 0.05:
            row -= 1
        along: FloatArray = self._points[row] - self._points[row - 1]
        unit: FloatArray = along / max(float(np.linalg.norm(along)), 1e-9)
        return unit


def _main_line(successors: Any) -> list[int]:
    """Returns the nodes of the main road, beginning at the start line."""
    chain, node = [], 0
    while node not in chain:
        chain.append(node)
        node = successors[node][0]
    return chain


def _rotation_of(yaw: float, climb: float) -> list[float]:
    """Returns the quaternion x, y, z, w of a turn by ``yaw``, then nose up by ``climb`` [rad]."""
    sy, cy = math.sin(yaw / 2), math.cos(yaw / 2)
    sp, cp = math.sin(-climb / 2), math.cos(-climb / 2)
    return [cy * sp, sy * cp, -sy * sp, cy * cp]


def _turned(rotation: list[float], angle: float) -> list[float]:
    """Returns a rotation after a turn about the kart's own vertical axis [rad]."""
    x, y, z, w = rotation
    s, c = math.sin(angle / 2), math.cos(angle / 2)
    return [x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s]
