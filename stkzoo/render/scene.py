"""The data of a race that renderers use, and its standings."""

from __future__ import annotations

from dataclasses import dataclass, field

from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.render.palette import race_palette


@dataclass(frozen=True)
class Scene:
    """A race in the form that renderers use.

    Attributes:
        setup: setup of the race in the engine.
        track_map: map of the track.
        kart_types: model of each kart, in grid order.
        kart_indices: kart of each agent; the game drives the other karts.
        names: name of each kart, in grid order; generated if left out.
        colors: color of each kart, in grid order; agents come first in :func:`race_palette`.
    """

    setup: RaceSetup
    track_map: TrackMap
    kart_types: tuple[str, ...]
    kart_indices: tuple[int, ...]
    names: tuple[str, ...] = ()
    colors: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        karts = range(self.num_kart)
        agents_first = dict.fromkeys((*self.kart_indices, *karts))
        colors = dict(zip(agents_first, race_palette(self.num_kart), strict=True))
        object.__setattr__(self, "colors", tuple(colors[kart] for kart in karts))
        if not self.names:
            default = {kart: f"kart_{agent}" for agent, kart in enumerate(self.kart_indices)}
            in_setup = enumerate(kart.name for kart in self.setup.karts)
            names = tuple(name or default.get(kart, "the game") for kart, name in in_setup)
            object.__setattr__(self, "names", names)

    @property
    def num_kart(self) -> int:
        """Number of karts."""
        return len(self.setup.karts)

    @property
    def title(self) -> str:
        """Display name of the track."""
        name = self.setup.track.replace("_", " ")
        return f"{name} (reverse)" if self.setup.reverse else name

    def label(self, kart: int) -> str:
        """Returns a kart's label on the map: its agent's number, or a dot."""
        return str(self.kart_indices.index(kart)) if kart in self.kart_indices else ""


@dataclass(frozen=True, slots=True)
class RaceStanding:
    """One line of the standings.

    Attributes:
        rank: rank, 1 is first.
        kart: index in grid order.
        name: display name.
        color: ``"#rrggbb"``.
        progress: completed fraction of the race, 0 to 1.
        detail: its finish time or its lap.
        has_finished: whether it has finished.
    """

    rank: int
    kart: int
    name: str
    color: str
    progress: float
    detail: str
    has_finished: bool

    @property
    def outcome(self) -> str:
        """Its finish time, or the completed share of the race, which is below 100%."""
        share = min(int(100 * self.progress), 99)
        return self.detail if self.has_finished else f"{share}% of the way"


def standings(scene: Scene, snapshot: Snapshot) -> list[RaceStanding]:
    """Returns the standings of all karts, best rank first."""
    length = scene.track_map.length * scene.setup.laps
    lines = []
    for kart, record in enumerate(snapshot.karts):
        finished = bool(record["has_finished_race"])
        distance = max(0.0, float(record["overall_distance"]))
        lap = min(max(int(record["finished_laps"]) + 1, 1), scene.setup.laps)
        lines.append(
            RaceStanding(
                rank=int(record["position"]),
                kart=kart,
                name=scene.names[kart],
                color=scene.colors[kart],
                progress=1.0 if finished else min(distance / length, 1.0),
                detail=clock(float(record["finish_time"])) if finished else f"lap {lap}",
                has_finished=finished,
            )
        )
    return sorted(lines, key=lambda line: (line.rank, line.kart))


def ordinal(rank: int) -> str:
    """Formats a rank, such as 1st."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(rank % 10, "th")  # codespell:ignore nd
    return f"{rank}{'th' if 10 < rank % 100 < 14 else ending}"


def clock(seconds: float) -> str:
    """Formats a race time [s] as minutes, seconds and tenths."""
    tenths = round(max(0.0, seconds) * 10)
    return f"{tenths // 600}:{tenths // 10 % 60:02d}.{tenths % 10}"
