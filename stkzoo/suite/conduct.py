"""Conduct: how often karts touch others, leave the road and overtake in recorded races."""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt
from msgspec import Meta

from stkzoo._schema import Seconds, Whole
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
_NonNegative = Annotated[float, Meta(ge=0)]


@dataclass(frozen=True, slots=True)
class Conduct:
    """The conduct of a kart in a race, or the means of several karts.

    Attributes:
        driver: display name of the driver.
        source: the driver's source.
        races: number of races, once for each kart.
        contacts: contacts with other karts, per race.
        closing: mean speed toward the nearest kart before a contact [m/s]; ``None`` without
            contacts.
        off_road: time beside the road per race [s].
        overtakes: karts that it overtook, per race.
    """

    driver: str
    source: str
    races: Whole
    contacts: _NonNegative
    closing: float | None
    off_road: Seconds
    overtakes: _NonNegative

    @classmethod
    def of(cls, driver: str, source: str, races: int, sums: npt.NDArray[np.float64]) -> Conduct:
        """Returns the conduct of a driver.

        Args:
            driver: display name of the driver.
            source: the driver's source.
            races: number of races.
            sums: ``(4,)`` float64: contacts, time off the road, overtakes and closing speeds.
        """
        contacts, off_road, overtakes, speeds = sums.tolist()
        mean = round(speeds / contacts, 3) if contacts else None
        return cls(
            driver,
            source,
            races,
            round(contacts / races, 3),
            mean,
            round(off_road / races, 3),
            round(overtakes / races, 3),
        )

    @property
    def sums(self) -> npt.NDArray[np.float64]:
        """The sums over races, as for :meth:`of`."""
        speed = self.contacts * (self.closing or 0.0)
        return self.races * np.array([self.contacts, self.off_road, self.overtakes, speed])


@dataclass(frozen=True, slots=True)
class RaceConduct(Document):
    """The conduct of all karts in a race.

    Attributes:
        replay: file of the recorded race.
        track: name of the track.
        reverse: whether the track was driven in reverse direction.
        karts: the karts, in the order of the agents.
    """

    kind: ClassVar[str] = "race-conduct"
    version: ClassVar[int] = 3  # 2: each contact had an entry
    origin: ClassVar[str] = "a race from `stkzoo suite conduct --json`"

    replay: str
    track: str
    reverse: bool
    karts: Annotated[tuple[Conduct, ...], Meta(min_length=1, max_length=256)]


def mean_conduct(races: Iterable[RaceConduct]) -> list[Conduct]:
    """Returns the mean conduct of each driver, in the order in which they occur.

    Args:
        races: the races.
    """
    karts: dict[tuple[str, str], list[Conduct]] = {}
    for kart in (kart for race in races for kart in race.karts):
        karts.setdefault((kart.driver, kart.source), []).append(kart)
    return [
        Conduct.of(*driver, len(rows), np.sum([kart.sums for kart in rows], axis=0))
        for driver, rows in karts.items()
    ]


class _ConductCounter(RaceListener):
    """Counts the events of all agents while they race.

    Attributes:
        sums: ``(A, 4)`` float64, as for :meth:`Conduct.of`.
    """

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        options, track = race.env.options, race.env.track_map
        assert track is not None  # noqa: S101 - the race has started
        self._events = RaceEvents(track, options.step_size, options.num_kart)
        self._before, self._karts = race.snapshot, list(race.race_info.kart_indices)
        self.sums = np.zeros((len(self._karts), len(_COLUMNS) + 1))

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._events.count(self._before, race.snapshot)
        counts = self._events.counts[np.ix_(self._karts, _COLUMNS)]
        speeds = counts[:, 0] * _closing_speeds(self._before.karts[self._karts])
        is_racing = [agent in race.observations for agent in race.env.possible_agents]
        self.sums[is_racing] += np.column_stack((counts, speeds))[is_racing]
        self._before = race.snapshot


def _closing_speeds(karts: npt.NDArray[np.void]) -> npt.NDArray[np.float64]:
    """Returns the speed ``(A,)`` of each kart toward the nearest other one [m/s]."""
    places, velocities = (karts[name].astype(float) for name in ("location", "velocity"))
    if len(karts) < 2:
        return np.zeros(len(karts))
    ways = places[None] - places[:, None]
    distances = np.linalg.norm(ways, axis=2)
    np.fill_diagonal(distances, np.inf)
    numbers, nearest = np.arange(len(karts)), distances.argmin(axis=1)
    toward = (velocities * ways[numbers, nearest]).sum(axis=1)
    speeds: npt.NDArray[np.float64] = toward / np.maximum(distances[numbers, nearest], 1e-6)
    return speeds


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
    karts = (
        Conduct.of(agent.name, agent.source, 1, sums)
        for agent, sums in zip(replay.agents, counter.sums, strict=True)
    )
    return RaceConduct(str(file), replay.track, replay.reverse, tuple(karts))


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
        ConfigError: a folder has no replays.
    """
    files: dict[Path, Path] = {}
    for path in map(Path, paths):
        folder = path / REPLAYS if (path / REPLAYS).is_dir() else path
        in_path = sorted(folder.glob(f"*{_ENDING}")) if folder.is_dir() else [path]
        if not in_path:
            raise ConfigError(
                f"{path} has no replays (*{_ENDING}); give a file from `stkzoo race --replay` or "
                "the folder of an entry from `stkzoo suite evaluate`"
            )
        files |= {file.resolve(): file for file in in_path}
    return [*files.values()]


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
    files = find_replays(paths)
    orders = [
        ConductOrder(number, (), RaceSettings(), replay=str(file.absolute()))
        for number, file in enumerate(files)
    ]
    races: dict[int, RaceConduct] = {}
    with closing(run_orders(orders, Path(), RunOptions(**options), RaceConduct)) as outcomes:
        for order, race, error in outcomes:
            if race is None:
                raise ReplayError(f"{files[order.number]}: {error}")
            races[order.number] = race
    return [races[number] for number in range(len(files))]
