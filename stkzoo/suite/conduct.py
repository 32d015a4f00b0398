"""Conduct: how often karts touch others, leave the road and overtake in recorded races."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from stkzoo._schema import Count, Seconds
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import REPLAYS, RaceOrder
from stkzoo.evaluation.batch.run import RunOptions, run_orders
from stkzoo.mdp.events import EVENTS, RaceEvents
from stkzoo.race.document import Document
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay import ReplayError, load_replay, play_replay
from stkzoo.race.settings import RaceSettings

_ENDING = ".stkz"
_COLUMNS = [EVENTS.index(name) for name in ("kart_contact", "off_road", "overtake")]


@dataclass(frozen=True, slots=True)
class Contact:
    """A contact of two karts.

    Attributes:
        step: step of the race in which they touch, from 1.
        karts: numbers of the two agents.
        closing: speed of either kart toward the other before they touch [m/s].
    """

    step: Count
    karts: tuple[Count, Count]
    closing: tuple[float, float]


@dataclass(frozen=True, slots=True)
class KartConduct:
    """The conduct of a kart in a race.

    Attributes:
        driver: display name of its driver.
        source: the driver's source.
        contacts: number of contacts with other karts.
        closing: mean speed toward the other kart before a contact [m/s]; ``None`` without contacts.
        off_road: time beside the road [s].
        overtakes: number of karts that it overtook.
    """

    driver: str
    source: str
    contacts: Count
    closing: float | None
    off_road: Seconds
    overtakes: Count


@dataclass(frozen=True, slots=True)
class RaceConduct(Document):
    """The conduct of all karts in a race.

    Attributes:
        replay: file of the recorded race.
        track: name of the track.
        reverse: whether the track was driven in reverse direction.
        steps: number of steps of the race.
        karts: the karts, in the order of the agents.
        contacts: the contacts, in the order of the race.
    """

    kind: ClassVar[str] = "race-conduct"
    version: ClassVar[int] = 2  # 1: contacts had a kart at fault
    origin: ClassVar[str] = "a race from `stkzoo suite conduct --json`"
    rows: ClassVar[str] = "contacts"

    replay: str
    track: str
    reverse: bool
    steps: Count
    karts: Annotated[tuple[KartConduct, ...], Meta(min_length=1, max_length=256)]
    contacts: tuple[Contact, ...]


@dataclass(frozen=True, slots=True)
class MeanConduct:
    """The mean conduct of a driver's karts.

    Attributes:
        driver: display name of the driver.
        races: number of races of its karts, once for each kart.
        contacts: contacts per race.
        closing: mean speed toward the other kart before a contact [m/s]; ``None`` without contacts.
        off_road: time beside the road per race [s].
        overtakes: overtakes per race.
    """

    driver: str
    races: int
    contacts: float
    closing: float | None
    off_road: float
    overtakes: float


def mean_conduct(races: Iterable[RaceConduct]) -> list[MeanConduct]:
    """Returns the mean conduct of each driver, in the order in which they occur.

    Args:
        races: the races.
    """
    karts: dict[tuple[str, str], list[KartConduct]] = {}
    for race in races:
        for kart in race.karts:
            karts.setdefault((kart.driver, kart.source), []).append(kart)
    return [_mean(driver, rows) for (driver, _), rows in karts.items()]


def _mean(driver: str, karts: Sequence[KartConduct]) -> MeanConduct:
    touching = [(kart.closing, kart.contacts) for kart in karts if kart.closing is not None]
    speeds = [speed for speed, contacts in touching for _ in range(contacts)]
    return MeanConduct(
        driver=driver,
        races=len(karts),
        contacts=fmean(kart.contacts for kart in karts),
        closing=fmean(speeds) if speeds else None,
        off_road=fmean(kart.off_road for kart in karts),
        overtakes=fmean(kart.overtakes for kart in karts),
    )


class _ConductCounter(RaceListener):
    """Counts the events of all agents while they race, and notes their contacts.

    Attributes:
        sums: ``(A, 3)`` float64: contacts, time off the road and overtakes of each agent.
        speeds: speeds of each agent toward the other kart of its contacts [m/s].
        contacts: the contacts.
    """

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        options, track = race.env.options, race.env.track_map
        assert track is not None  # noqa: S101 - the race has started
        self._events = RaceEvents(track, options.step_size, options.num_kart)
        self._before, self._karts = race.snapshot, list(race.race_info.kart_indices)
        self.sums = np.zeros((len(self._karts), len(_COLUMNS)))
        self.speeds: list[list[float]] = [[] for _ in self._karts]
        self.contacts: list[Contact] = []

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        is_new = self._events.is_next_counted
        self._events.count(self._before, race.snapshot)
        is_racing = [agent in race.observations for agent in race.env.possible_agents]
        counts = self._events.counts[np.ix_(self._karts, _COLUMNS)]
        self.sums[is_racing] += counts[is_racing]
        is_counted = self._events.contacts & is_new
        for pair in combinations(range(len(self._karts)), 2):
            one, other = (self._karts[number] for number in pair)
            if is_counted[one, other] and any(is_racing[number] for number in pair):
                closing = _closing(self._before, one, other)
                self.contacts.append(Contact(race.steps, pair, closing))
                for number, speed in zip(pair, closing, strict=True):
                    if is_racing[number]:
                        self.speeds[number].append(speed)
        self._before = race.snapshot


def _closing(snapshot: Snapshot, one: int, other: int) -> tuple[float, float]:
    """Returns the speed of each of two karts toward the other one [m/s]."""
    karts = snapshot.karts[[one, other]]
    way = karts["location"][1].astype(float) - karts["location"][0]
    speeds = karts["velocity"].astype(float) @ way / max(float(np.linalg.norm(way)), 1e-6)
    return round(float(speeds[0]), 3), round(-float(speeds[1]), 3)


def race_conduct(file: str | os.PathLike[str]) -> RaceConduct:
    """Plays a recorded race again and measures the conduct of its karts.

    Args:
        file: the replay.

    Raises:
        ReplayError: the replay is missing or damaged, or cannot be reproduced here.
        EngineError: the game crashed.
    """
    replay, counter = load_replay(file), _ConductCounter()
    playback = play_replay(replay, listeners=[counter])
    if not playback.is_exact:
        step = playback.first_difference
        where = "its result" if step is None else f"step {step}"
        raise ReplayError(
            f"the race differs from the recording {file} in {where}, and only exact replays show "
            "the conduct; `stkzoo replay` shows the difference"
        )
    rows = zip(replay.agents, counter.sums.tolist(), counter.speeds, strict=True)
    return RaceConduct(
        replay=str(file),
        track=replay.track,
        reverse=replay.reverse,
        steps=replay.steps,
        karts=tuple(
            KartConduct(
                driver=agent.name,
                source=agent.source,
                contacts=round(contacts),
                closing=round(fmean(speeds), 3) if speeds else None,
                off_road=round(off_road, 3),
                overtakes=round(overtakes),
            )
            for agent, (contacts, off_road, overtakes), speeds in rows
        ),
        contacts=tuple(counter.contacts),
    )


@dataclass(frozen=True, slots=True)
class ConductOrder(RaceOrder):
    """A recorded race to play again.

    Attributes:
        replay: file of the race.
    """

    replay: str = ""

    def run(self, folder: Path) -> RaceConduct:
        """Measures the conduct in a worker process.

        Args:
            folder: folder to which the file's path is relative.
        """
        return race_conduct(folder / self.replay)


def find_replays(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Returns the replays of entries and other folders, and single replays, each once.

    Args:
        paths: replays, folders with replays, or folders of batches, such as entries.

    Raises:
        ConfigError: a path does not exist, or a folder has no replays.
    """
    files: dict[Path, Path] = {}
    for file in (file for path in map(Path, paths) for file in _replays_in(path)):
        load_replay(file)
        files.setdefault(file.resolve(), file)
    return [*files.values()]


def _replays_in(path: Path) -> Iterator[Path]:
    folder = path / REPLAYS if (path / REPLAYS).is_dir() else path
    files = sorted(folder.glob(f"*{_ENDING}")) if folder.is_dir() else [path]
    if not files:
        raise ConfigError(
            f"{path} has no replays (*{_ENDING}); give a file from `stkzoo race --replay` or "
            "the folder of an entry from `stkzoo suite evaluate`"
        )
    yield from files


def measure_conduct(
    paths: Iterable[str | os.PathLike[str]],
    **options: Any,
) -> list[RaceConduct]:
    """Measures the conduct of the karts in many recorded races.

    Args:
        paths: replays and folders of entries; see :func:`find_replays`.
        **options: ``jobs``, ``race_timeout`` and ``on_race``, as in
            :class:`~stkzoo.evaluation.RunOptions`.

    Returns:
        The conduct in each race, in the order of the replays.

    Raises:
        ConfigError: there are no replays, or an option is invalid.
        ReplayError: a replay is damaged, or a race cannot be reproduced.
    """
    settings = RunOptions(**options)
    files = find_replays(paths)
    orders = [
        ConductOrder(number, (), RaceSettings(), replay=str(file.absolute()))
        for number, file in enumerate(files)
    ]
    races: dict[int, RaceConduct] = {}
    with closing(run_orders(orders, Path(), settings, RaceConduct)) as outcomes:
        for order, race, error in outcomes:
            if race is None:
                raise ReplayError(f"{files[order.number]}: {error}")
            races[order.number] = race
    return [races[number] for number in range(len(files))]
