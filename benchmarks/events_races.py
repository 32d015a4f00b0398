"""Races of scripted karts, recorded at the rate of the game's physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import race_v0
from stkzoo.agents import heuristic
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.starting import CenterLine
from stkzoo.engine.track import TrackMap
from stkzoo.mdp.geometry import rotation_matrices

#: Physics ticks per second, and per environment step of 0.1 s.
RATE, TICKS = 120, 12

Action = dict[str, Any]
Point = npt.NDArray[np.float64]
_BUTTONS = ("brake", "drift", "fire", "nitro", "rescue")


@dataclass(frozen=True)
class Recording:
    """A race, tick by tick.

    Attributes:
        track: the track.
        moments: snapshots of the start and of each tick.
        scripts: names of the agents' scripts, by kart.
    """

    track: TrackMap
    moments: list[Snapshot]
    scripts: dict[int, str]


def record(
    track: str, seed: int, scripts: Sequence[str], *, bots: int = 0, seconds: float = 60.0
) -> Recording:
    """Drives a race and records every tick; agents choose an action every 0.1 s."""
    num_kart = len(scripts) + bots
    with race_v0.parallel_env(
        num_kart=num_kart,
        agents=len(scripts),
        track=track,
        laps=2,
        difficulty=3,
        step_size=1 / RATE,
        max_cycles=None,
    ) as env:
        observations, _ = env.reset(seed=seed)
        karts = dict(zip(env.agents, env.race.kart_indices, strict=True))
        names = dict(zip(env.agents, scripts, strict=True))
        drivers = {agent: SCRIPTS[name](env.track_map) for agent, name in names.items()}
        moments = [env.snapshot]
        for step in range(round(seconds * RATE / TICKS)):
            if not env.agents:
                break
            now = env.snapshot
            actions = {
                agent: drivers[agent](now, karts[agent], step * TICKS / RATE, observations[agent])
                for agent in env.agents
            }
            for _ in range(TICKS):
                observations, *_ = env.step(actions)
                moments.append(env.snapshot)
        return Recording(env.track_map, moments, {karts[a]: name for a, name in names.items()})


class Follower:
    """Drives along the center line; base class of the other scripts."""

    def __init__(self, track: TrackMap) -> None:
        self.line = CenterLine(track)
        self._place, self._there_since = np.full(3, np.inf), 0.0

    def __call__(self, now: Snapshot, kart: int, time: float, seen: Mapping[str, Any]) -> Action:
        """Returns the action of a kart at a moment."""
        del seen
        own = now.karts[kart]
        if np.linalg.norm(own["location"] - self._place) > 3.0 or not now.header["time"] > 0:
            self._place, self._there_since = own["location"].astype(np.float64), time
        there = time - self._there_since
        if there > 5.0:
            self._there_since = time
            return action(rescue=1)
        if 1.5 < there <= 2.5 or 3.5 < there <= 4.5:
            return action(brake=1)
        return drive_to(own, self.target(now, kart, time), fire=int(time % 2.0 < 0.15))

    def target(self, now: Snapshot, kart: int, time: float) -> Point:
        """Returns the point that the kart drives toward."""
        del time
        return self.line.point(float(now.karts[kart]["distance_down_track"]) + 12.0)


class Rammer(Follower):
    """Drives into the nearest kart within 25 m, for six of every nine seconds."""

    def target(self, now: Snapshot, kart: int, time: float) -> Point:
        """Returns the position of the nearest kart in 0.3 s, or a point of the road ahead."""
        places = now.karts["location"].astype(np.float64)
        apart = np.linalg.norm(places - places[kart], axis=1)
        apart[kart] = np.inf
        victim = int(apart.argmin())
        if apart[victim] > 25.0 or time % 9.0 > 6.0:
            return super().target(now, kart, time)
        place: Point = places[victim] + 0.3 * now.karts["velocity"][victim]
        return place


class Cutter(Follower):
    """Leaves the road for three of every seven seconds, on alternating sides."""

    def target(self, now: Snapshot, kart: int, time: float) -> Point:
        """Returns a point of the road ahead, or a point beside it."""
        ahead = float(now.karts[kart]["distance_down_track"]) + 12.0
        place, along = self.line.point(ahead), self.line.direction(ahead)
        side = np.array([along[2], 0.0, -along[0]]) * (1.0 if time % 14.0 < 7.0 else -1.0)
        return place + (time % 7.0 > 4.0) * side * (self.line.half_width(ahead) + 6.0)


class Ghost(Follower):
    """Drives the wrong way for the last eight of every 18 seconds."""

    def target(self, now: Snapshot, kart: int, time: float) -> Point:
        """Returns a point of the road ahead or behind."""
        here = float(now.karts[kart]["distance_down_track"])
        return self.line.point(here + (-12.0 if time % 18.0 > 10.0 else 12.0))


class Expert:
    """The heuristic driver."""

    def __init__(self, track: TrackMap) -> None:
        del track
        self._state = heuristic.create_state()

    def __call__(self, now: Snapshot, kart: int, time: float, seen: Mapping[str, Any]) -> Action:
        """Returns the action of a kart at a moment."""
        del now, kart, time
        return self._state.drive(seen)


SCRIPTS: dict[str, Callable[[TrackMap], Follower | Expert]] = {
    "rammer": Rammer,
    "cutter": Cutter,
    "ghost": Ghost,
    "expert": Expert,
}


def action(acceleration: float = 0.0, steer: float = 0.0, **buttons: int) -> Action:
    """Returns an action of the ``full`` view."""
    numbers = {"acceleration": acceleration, "steer": steer}
    return {
        **{name: np.full(1, number, np.float32) for name, number in numbers.items()},
        **dict.fromkeys(_BUTTONS, 0),
        **buttons,
    }


def drive_to(own: np.void, place: Point, **buttons: int) -> Action:
    """Returns an action that drives toward a point at full throttle, less in sharp turns."""
    axes = rotation_matrices(own["rotation"].astype(np.float64)[None])[0]
    right, _, forward = axes @ (place - own["location"])
    angle = math.atan2(right, forward)
    throttle = 1.0 if abs(angle) < 0.6 or own["speed"] < 8.0 else 0.2
    return action(throttle, max(-1.0, min(1.0, 2.5 * angle)), **buttons)
