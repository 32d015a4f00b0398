"""Conduct: how karts behave in recorded races, and which of them are at fault in contacts.

A kart is at fault in a contact if reference drivers in its place avoid it, and from a later start
than in the place of the other kart (:mod:`stkzoo.suite.conduct.counterfactuals`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, ClassVar

from stkzoo._os import cpu_count
from stkzoo._schema import Count, Seconds, Within
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import REPLAYS, RaceOrder
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.batch.run import BatchProgress, RunOptions
from stkzoo.race.document import Document
from stkzoo.race.listeners import RaceListener
from stkzoo.race.replay import Replay, ReplayError, load_replay, play_replay
from stkzoo.race.settings import RaceSettings
from stkzoo.suite.conduct.contacts import ConductCounter, merge_touches
from stkzoo.suite.conduct.counterfactuals import CounterfactualJudge, JudgedContact

#: Touches of the same two karts within this time are one contact for the judge [s].
MERGED_WITHIN = 1.0
#: Maximum number of contacts of a race that are judged, from the start of the race.
MAX_JUDGED = 200
_ENDING = ".stkz"


@dataclass(frozen=True, slots=True)
class KartConduct:
    """The conduct of a kart in a race.

    Attributes:
        driver: display name of its driver.
        source: the driver's source.
        contacts: number of contacts with other karts.
        at_fault: number of contacts in which it was at fault; ``None`` for the game's AI, which has
            no substitute.
        off_road: time beside the road [s].
        overtakes: number of karts that it overtook.
    """

    driver: str
    source: str
    contacts: Count
    at_fault: Count | None
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
        contacts: the judged contacts, in the order of the race.
        not_judged: number of further contacts, in which nobody is at fault.
    """

    kind: ClassVar[str] = "race-conduct"
    origin: ClassVar[str] = "a race from `stkzoo suite conduct --json`"
    rows: ClassVar[str] = "contacts"

    replay: str
    track: str
    reverse: bool
    steps: Count
    karts: Annotated[tuple[KartConduct, ...], Within(1, 256)]
    contacts: tuple[JudgedContact, ...]
    not_judged: Count = 0


@dataclass(frozen=True, slots=True)
class MeanConduct:
    """The mean conduct of a driver's karts.

    Attributes:
        driver: display name of the driver.
        races: number of races of its karts, once for each kart.
        contacts: contacts per race.
        at_fault: contacts at fault per race; ``None`` for the game's AI.
        off_road: time beside the road per race [s].
        overtakes: overtakes per race.
    """

    driver: str
    races: int
    contacts: float
    at_fault: float | None
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
    return [_mean(driver, own) for (driver, _), own in karts.items()]


def _mean(driver: str, karts: Sequence[KartConduct]) -> MeanConduct:
    faults = [kart.at_fault for kart in karts if kart.at_fault is not None]
    return MeanConduct(
        driver=driver,
        races=len(karts),
        contacts=fmean(kart.contacts for kart in karts),
        at_fault=fmean(faults) if faults else None,
        off_road=fmean(kart.off_road for kart in karts),
        overtakes=fmean(kart.overtakes for kart in karts),
    )


def race_conduct(
    file: str | os.PathLike[str], agents: Collection[int] | None = None
) -> RaceConduct:
    """Plays a recorded race again and measures the conduct of its karts.

    A race with contacts is played twice, the second time with copies of it for each contact.

    Args:
        file: the replay.
        agents: numbers of the agents whose contacts are judged; ``None`` for all.

    Raises:
        ReplayError: the replay is missing or damaged, or cannot be reproduced here.
        EngineError: this platform cannot copy races, or the game crashed.
    """
    replay, counter = load_replay(file), ConductCounter()
    _play(file, replay, counter)
    contacts = merge_touches(counter.touches, round(MERGED_WITHIN / replay.step_size))
    chosen = [own for own in contacts if agents is None or not {*own.karts}.isdisjoint(agents)]
    judge = CounterfactualJudge(replay, chosen[:MAX_JUDGED])
    if chosen:
        _play(file, replay, judge)
    return RaceConduct(
        replay=str(file),
        track=replay.track,
        reverse=replay.reverse,
        steps=replay.steps,
        karts=tuple(
            _kart(replay, number, row, judge.judged)
            for number, row in enumerate(counter.sums.tolist())
        ),
        contacts=tuple(judge.judged),
        not_judged=len(contacts) - len(judge.judged),
    )


def _play(file: str | os.PathLike[str], replay: Replay, listener: RaceListener) -> None:
    playback = play_replay(replay, listeners=[listener])
    if not playback.is_exact:
        step = playback.first_difference
        where = "its result" if step is None else f"step {step}"
        raise ReplayError(
            f"the race differs from the recording {file} in {where}, and only exact replays can be "
            "judged; `stkzoo replay` shows the difference"
        )


def _kart(
    replay: Replay, number: int, sums: Sequence[float], judged: Iterable[JudgedContact]
) -> KartConduct:
    agent, (contacts, off_road, overtakes) = replay.agents[number], sums
    faults = (own for own in judged if number == own.at_fault)
    at_fault = sum(own.counts[own.karts.index(number)] for own in faults)
    return KartConduct(
        driver=agent.name,
        source=agent.source,
        contacts=round(contacts),
        at_fault=None if agent.is_game_ai else at_fault,
        off_road=round(off_road, 3),
        overtakes=round(overtakes),
    )


@dataclass(frozen=True, slots=True)
class ConductOrder(RaceOrder):
    """A recorded race to judge.

    Attributes:
        replay: file of the race.
    """

    replay: str = ""

    def run(self, folder: Path) -> RaceConduct:
        """Judges the race in a worker process.

        Args:
            folder: folder to which the file's path is relative.
        """
        return race_conduct(folder / self.replay)

    def suspects(self) -> tuple[int, ...]:
        """See :meth:`RaceOrder.suspects`. No code of agents runs."""
        return ()


def find_replays(places: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """Returns the replays of entries and other folders, and single replays, each once.

    Args:
        places: replays, folders with replays, or folders of batches, such as entries.

    Raises:
        ConfigError: a place does not exist, or a folder has no replays.
    """
    files: dict[Path, Path] = {}
    for place in map(Path, places):
        folder = place / REPLAYS if (place / REPLAYS).is_dir() else place
        found = sorted(folder.glob(f"*{_ENDING}")) if folder.is_dir() else [place]
        if not found:
            raise ConfigError(
                f"{place} has no replays (*{_ENDING}); give a file from `stkzoo race --replay` or "
                "the folder of an entry from `stkzoo suite evaluate`"
            )
        for file in found:
            load_replay(file)
            files.setdefault(file.resolve(), file)
    return [*files.values()]


def measure_conduct(
    places: Iterable[str | os.PathLike[str]],
    *,
    jobs: int | None = None,
    race_timeout: float = 3600.0,
    on_race: Callable[[BatchProgress], object] | None = None,
) -> list[RaceConduct]:
    """Measures the conduct of the karts in many recorded races.

    Args:
        places: replays and folders of entries; see :func:`find_replays`.
        jobs: number of races at the same time; by default one per processor core.
        race_timeout: time limit of a race [s].
        on_race: function that is called after each race.

    Returns:
        The conduct in each race, in the order of the replays.

    Raises:
        ConfigError: there are no replays, or an option is invalid.
        ReplayError: a replay is damaged, or a race could not be judged.
    """
    RunOptions(jobs, race_timeout)  # checks the values
    files = find_replays(places)
    orders = [
        ConductOrder(number, (), RaceSettings(), replay=str(file.absolute()))
        for number, file in enumerate(files)
    ]
    report = on_race or (lambda _: None)
    found: dict[int, RaceConduct] = {}
    report(BatchProgress(0, len(orders)))
    with closing(run_in_parallel(orders, Path(), jobs or cpu_count(), race_timeout)) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                raise ReplayError(f"{files[outcome.order.number]}: {outcome.error}")
            found[outcome.order.number] = RaceConduct.from_json(outcome.result)
            report(BatchProgress(len(found), len(orders)))
    return [found[number] for number in range(len(files))]
