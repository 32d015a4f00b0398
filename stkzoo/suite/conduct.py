"""Conduct: how often karts touch others, leave the road and overtake in recorded races."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import REPLAYS
from stkzoo.mdp.events import EVENTS, RaceEvents
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay import Replay, ReplayError, load_replay, play_replay

_ENDING = ".stkz"
_COLUMNS = [EVENTS.index(name) for name in ("kart_contact", "off_road", "overtake")]


@dataclass(frozen=True, slots=True)
class Conduct:
    """The mean conduct of a driver's karts in recorded races.

    Attributes:
        driver: display name of the driver.
        races: number of races, once for each kart.
        contacts: contacts with other karts, per race.
        closing: mean speed toward the nearest kart before a contact [m/s]; ``None`` without
            contacts.
        off_road: time beside the road per race [s].
        overtakes: karts that it overtook, per race.
    """

    driver: str
    races: int
    contacts: float
    closing: float | None
    off_road: float
    overtakes: float


def measure_conduct(paths: Iterable[str | os.PathLike[str]]) -> list[Conduct]:
    """Plays recorded races again and measures the conduct of the drivers, in their order there.

    Args:
        paths: replays, folders with replays, or folders of batches, such as entries.

    Raises:
        ConfigError: a folder has no replays.
        ReplayError: a replay is missing or damaged, or a race cannot be reproduced here.
        EngineError: the game crashed.
    """
    drivers: dict[tuple[str, str], list[npt.NDArray[np.float64]]] = {}
    for replay in [load_replay(file) for file in find_replays(paths)]:
        for agent, sums in zip(replay.agents, event_sums(replay), strict=True):
            drivers.setdefault((agent.name, agent.source), []).append(sums)
    return [_mean(name, np.array(rows)) for (name, _), rows in drivers.items()]


def _mean(driver: str, rows: npt.NDArray[np.float64]) -> Conduct:
    contacts, off_road, overtakes, _ = rows.mean(axis=0).round(3).tolist()
    touches, _, _, speeds = rows.sum(axis=0).tolist()
    closing = round(speeds / touches, 3) if touches else None
    return Conduct(driver, len(rows), contacts, closing, off_road, overtakes)


def event_sums(replay: Replay) -> npt.NDArray[np.float64]:
    """Plays a recorded race again and counts the events of its karts.

    Args:
        replay: the recording.

    Returns:
        ``(A, 4)`` float64: contacts of each agent, time off the road [s], overtakes, and the sum
        over contacts of the speed toward the nearest kart [m/s].

    Raises:
        ReplayError: the race cannot be reproduced here.
    """
    counter = _ConductCounter()
    playback = play_replay(replay, listeners=[counter])
    if not playback.is_exact:
        step = playback.first_difference
        where = "its result" if step is None else f"step {step}"
        raise ReplayError(
            f"the race on {replay.track} differs from its recording in {where}, and only exact "
            "replays show the conduct; `stkzoo replay` shows the difference"
        )
    return counter.sums


class _ConductCounter(RaceListener):
    """Counts the events of all agents while they race.

    Attributes:
        sums: ``(A, 4)`` float64, as :func:`event_sums` returns them.
    """

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        options = race.env.options
        self._events = RaceEvents(race.scene.track_map, options.step_size, options.num_kart)
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


def find_replays(paths: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Returns the replays of entries and other folders, and single replays, each once.

    Args:
        paths: replays, folders with replays, or folders of batches, such as entries.

    Raises:
        ConfigError: a folder has no replays.
    """
    files: dict[str, Path] = {}
    for path in map(Path, paths):
        folder = path / REPLAYS if (path / REPLAYS).is_dir() else path
        in_path = sorted(folder.glob(f"*{_ENDING}")) if folder.is_dir() else [path]
        if not in_path:
            raise ConfigError(
                f"{path} has no replays (*{_ENDING}); give a file from `stkzoo race --replay` or "
                "the folder of an entry from `stkzoo suite evaluate`"
            )
        files |= {os.path.realpath(file): file for file in in_path}
    return [*files.values()]
