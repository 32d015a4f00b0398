"""Starts of training races: who drives, and from where.

A race begins as a copy of a waiting race in the GO phase: copying takes milliseconds, starting the
game a tenth of a second. One waiting race is kept per track, direction, lineup and starting point.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.engine import KartSetup, RaceSetup, Snapshot, TrackMap, WorkerSession, decode_track
from stkzoo.engine.assets import find_assets
from stkzoo.engine.ground import ground_of
from stkzoo.errors import ConfigError
from stkzoo.names import Phase
from stkzoo.wrappers.racing import (
    BatchedRacingLines,
    BatchedRacingView,
    LineTables,
    RoadTable,
    line_tables,
)

#: Number of learners, of karts of the game's AI, and of races; see :func:`parse_races`.
_RACES = re.compile(r"([1-9]\d*)(?:\+(\d+))?(?:x([1-9]\d*))?")


@dataclass(frozen=True, slots=True)
class Lineup:
    """Number of learners and of karts of the game's AI in a race."""

    learners: int
    bots: int
    difficulty: int = 3


def parse_races(texts: Sequence[str]) -> list[Lineup]:
    """Parses ``4x3`` (three races of four learners) or ``2+2x1`` (two learners, two AI karts).

    Returns:
        The lineup of each race.

    Raises:
        ConfigError: a text has another form.
    """
    lineups = []
    for text in texts:
        if not (found := _RACES.fullmatch(text)):
            raise ConfigError(
                f"races {text!r} are invalid; expected for example 4x3 (three races of four "
                "agents) or 2+2x1 (one race of two agents and two karts of the game's AI)"
            )
        learners, bots, races = (int(number or 0) for number in found.groups())
        lineups += [Lineup(learners, bots)] * (races or 1)
    return lineups


@dataclass(frozen=True, slots=True)
class StartingPoint:
    """The start of a race; its number determines the grid positions and the engine's seed."""

    track: str
    reverse: bool
    number: int
    lineup: Lineup

    def setup(self) -> RaceSetup:
        """Returns the engine's setup."""
        seed = np.random.SeedSequence(
            [
                self.number,
                self.reverse,
                self.lineup.learners,
                self.lineup.bots,
                *self.track.encode(),
            ]
        )
        random = np.random.default_rng(seed)
        karts = [KartSetup(is_bot=False)] * self.lineup.learners + [KartSetup()] * self.lineup.bots
        order = random.permutation(len(karts))
        return RaceSetup(
            track=self.track,
            karts=tuple(karts[place] for place in order),
            reverse=self.reverse,
            difficulty=self.lineup.difficulty,
            seed=int(random.integers(2**16)),
        )


class RaceStarts:
    """Waiting races in the GO phase, each started on first use.

    Attributes:
        root: folder of the game's data.
        tables: lines of the tracks, by number.
        view: makes the racing view on these tracks.
    """

    def __init__(self) -> None:
        self.root = find_assets().root
        self._sessions: dict[StartingPoint, tuple[WorkerSession, Snapshot]] = {}
        self._roads: dict[tuple[str, bool], int] = {}
        self._tracks: list[TrackMap] = []
        self._lines: list[LineTables] = []
        self._racing_lines = BatchedRacingLines([])
        self.tables: list[RoadTable] = []
        self.view = BatchedRacingView([])

    def begin(self, start: StartingPoint, session: WorkerSession) -> Snapshot:
        """Starts a race in a session; returns its first snapshot."""
        if start not in self._sessions:
            self._sessions[start] = self._start(start)
        waiting, snapshot = self._sessions[start]
        session.resume(waiting)
        return snapshot

    def _start(self, point: StartingPoint) -> tuple[WorkerSession, Snapshot]:
        session = WorkerSession(self.root)
        start = session.start(point.setup())
        self._add_road(point, decode_track(start.track))
        snapshot = start.snapshot
        full_throttle = np.zeros((point.lineup.learners, 7), np.float32)
        full_throttle[:, 0] = 1.0
        while snapshot.phase < Phase.GO_PHASE:
            snapshot = session.step(full_throttle)
        return session, snapshot

    def _add_road(self, point: StartingPoint, track: TrackMap) -> None:
        key = point.track, point.reverse
        if key not in self._roads:
            self._roads[key] = len(self.tables)
            self._tracks.append(track)
            self.tables.append(RoadTable(track))
            self.view = BatchedRacingView(self.tables)

    def road(self, point: StartingPoint) -> int:
        """Returns the number of a race's track in ``view``; the race must have started before."""
        return self._roads[point.track, point.reverse]

    def racing_lines(self) -> BatchedRacingLines:
        """Returns the racing lines of all tracks; takes some seconds for each new one."""
        if len(self._lines) < len(self._roads):
            for (track, reverse), number in list(self._roads.items())[len(self._lines) :]:
                course = self._tracks[number]
                ground = ground_of(course, track, self.root, reverse=reverse)
                self._lines.append(line_tables(course, ground))
            self._racing_lines = BatchedRacingLines(self._lines)
        return self._racing_lines

    def close(self, keep: Collection[StartingPoint] = ()) -> None:
        """Closes the waiting races, except those at some starting points."""
        for point in set(self._sessions) - set(keep):
            self._sessions.pop(point)[0].close()
