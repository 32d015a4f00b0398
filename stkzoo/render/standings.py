"""Who is where in a race, as the panels of pictures tell it."""

from __future__ import annotations

from dataclasses import dataclass

from stkzoo.engine.snapshot import Snapshot
from stkzoo.render.scene import Scene

__all__ = ["Standing", "clock", "standings"]


@dataclass(frozen=True, slots=True)
class Standing:
    """One line of the standings.

    Attributes:
        rank: its place, 1 is first.
        kart: index in grid order.
        name: what it is called.
        colour: as ``"#rrggbb"``.
        progress: part of the race that is done, 0 to 1.
        detail: its time at the finish, or its lap.
        has_finished: whether it has finished.
    """

    rank: int
    kart: int
    name: str
    colour: str
    progress: float
    detail: str
    has_finished: bool


def standings(scene: Scene, snapshot: Snapshot) -> list[Standing]:
    """All karts, best rank first."""
    length = scene.track_map.length * scene.setup.laps
    lines = []
    for kart, record in enumerate(snapshot.karts):
        finished = bool(record["has_finished_race"])
        distance = max(0.0, float(record["overall_distance"]))
        lap = min(max(int(record["finished_laps"]) + 1, 1), scene.setup.laps)
        lines.append(
            Standing(
                rank=int(record["position"]),
                kart=kart,
                name=scene.names[kart],
                colour=scene.colours[kart],
                progress=1.0 if finished else min(distance / length, 1.0),
                detail=clock(float(record["finish_time"])) if finished else f"lap {lap}",
                has_finished=finished,
            )
        )
    return sorted(lines, key=lambda line: (line.rank, line.kart))


def clock(seconds: float) -> str:
    """A race time for people: minutes, seconds, tenths."""
    tenths = round(max(0.0, seconds) * 10)
    return f"{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"
