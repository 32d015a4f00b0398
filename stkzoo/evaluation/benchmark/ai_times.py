"""The finish times of the game's AI on every track, to which benchmarks compare an agent's."""

from __future__ import annotations

import itertools
import math
import os
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

from stkzoo._checks import check_whole
from stkzoo._schema import Level, Positive, Whole, one_of
from stkzoo.errors import ConfigError
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import BatchPlan, find_tracks
from stkzoo.evaluation.batch.run import BatchKind, RunOptions, written
from stkzoo.evaluation.benchmark.races import FRONT, direction_name, race_seed
from stkzoo.race.document import Document
from stkzoo.race.result import RaceResult, versions_now
from stkzoo.race.settings import RaceSettings

AI_TIMES_FILE = "ai_times.json"
_SHIPPED_FILE = Path(__file__).parent / AI_TIMES_FILE
_KARTS = 5
_MAX_SEEDS = 1000

RaceKey = tuple[str, bool, int]


@dataclass(frozen=True, slots=True)
class AiTime:
    """The AI's finish times on one track, in one direction, at one difficulty.

    Attributes:
        track: name of the track.
        direction: ``"forward"`` or ``"reversed"``.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        median: median of all karts [s]; karts that did not finish count as slowest.
        best: shortest finish time [s].
        worst: longest finish time [s].
        karts: number of karts.
        finished: number of karts that finished.
    """

    track: str
    direction: Annotated[str, one_of("forward", "reversed")]
    difficulty: Level
    median: Positive
    best: Positive
    worst: Positive
    karts: Whole
    finished: Whole

    @classmethod
    def of(cls, key: RaceKey, times: Sequence[float | None]) -> AiTime | None:
        """Returns the statistics of finish times.

        Args:
            key: track, ``reverse`` and difficulty.
            times: finish times of the karts of all races [s]; ``None`` for a kart that did not
                finish.

        Returns:
            The statistics; ``None`` if the median is unknown because too few karts finished.
        """
        track, reverse, difficulty = key
        finished = [time for time in times if time is not None]
        median = statistics.median([math.inf if time is None else time for time in times])
        if not math.isfinite(median):
            return None
        return cls(
            track=track,
            direction=direction_name(reverse),
            difficulty=difficulty,
            median=round(median, 3),
            best=round(min(finished), 3),
            worst=round(max(finished), 3),
            karts=len(times),
            finished=len(finished),
        )


@dataclass(frozen=True)
class AiTimes(Document):
    """The AI's finish times on several tracks.

    Attributes:
        versions: versions of the software with which they were measured.
        times: the times for each track, direction and difficulty.
    """

    # docs/schemas/ai-times.schema.json
    type_name: ClassVar[str] = "ai-times"
    origin: ClassVar[str] = f"the {AI_TIMES_FILE} of `stkzoo benchmark --baseline`"
    rows: ClassVar[str] = "times"

    versions: Mapping[str, str]
    times: tuple[AiTime, ...]

    @cached_property
    def by_race(self) -> dict[RaceKey, AiTime]:
        """The times, by track, ``reverse`` and difficulty."""
        is_reversed = {direction_name(reverse): reverse for reverse in (False, True)}
        return {(t.track, is_reversed[t.direction], t.difficulty): t for t in self.times}

    def of(self, track: str, reverse: bool, difficulty: int) -> AiTime:
        """Returns the times on one track.

        Args:
            track: name of the track.
            reverse: the direction.
            difficulty: difficulty of the races.

        Raises:
            ConfigError: these times have not been measured.
        """
        try:
            return self.by_race[track, reverse, difficulty]
        except KeyError:
            raise ConfigError(
                f"the game's AI has no time on {track} ({direction_name(reverse)}) at difficulty "
                f"{difficulty}; measure it: stkzoo benchmark --baseline --track {track} --output "
                "ai-times, then pass --ai-times ai-times/ai_times.json"
            ) from None

    @classmethod
    def from_races(cls, results: Iterable[RaceResult]) -> AiTimes:
        """Returns the times from the results of races in which the AI drove all karts."""
        times: dict[RaceKey, list[float | None]] = {}
        for result in results:
            of_race = times.setdefault((result.track, result.reverse, result.difficulty), [])
            of_race += [row.finish_time for row in result.agents]
        known = (AiTime.of(race, times[race]) for race in sorted(times))
        return cls(versions_now(), tuple(time for time in known if time is not None))


def load_ai_times(path: str | os.PathLike[str] | None = None) -> AiTimes:
    """Loads the AI's finish times.

    Args:
        path: a file from ``stkzoo benchmark --baseline``; by default, the file that comes with
            stkzoo.

    Raises:
        ConfigError: the file cannot be read.
    """
    return _shipped_times() if path is None else AiTimes.load(Path(path))


@cache
def _shipped_times() -> AiTimes:
    return AiTimes.load(_SHIPPED_FILE)


@dataclass(frozen=True, slots=True, kw_only=True)
class AiTimesPlan(BatchPlan):
    """The plan of races in which the game's AI drives all karts, in both directions.

    Attributes:
        seeds: number of races with five karts for each track, direction and difficulty.
        difficulties: levels of the AI.
    """

    type_name: ClassVar[str] = "ai-times-plan"
    noun: ClassVar[str] = "measurement"
    resume_command: ClassVar[str] = "stkzoo benchmark --baseline --output {folder}"

    seeds: int
    difficulties: tuple[int, ...]

    def __post_init__(self) -> None:
        check_whole("seeds", self.seeds, 1, _MAX_SEEDS)
        for difficulty in self.difficulties:
            check_whole("difficulty", difficulty, 0, 3)


def _orders(plan: AiTimesPlan) -> list[RaceOrder]:
    """Returns the orders of all races in which the AI's times are measured."""
    races = itertools.product(plan.difficulties, plan.tracks, (False, True), range(plan.seeds))
    return [
        RaceOrder(
            number,
            ("ai",) * _KARTS,
            RaceSettings(
                track=track,
                reverse=reverse,
                difficulty=difficulty,
                seed=race_seed(track, reverse, "A" * _KARTS, FRONT, index),
                max_paths=1,  # the AI does not use observations
            ),
        )
        for number, (difficulty, track, reverse, index) in enumerate(races)
    ]


def plan_ai_times(
    *,
    tracks: str | Sequence[str] = "all",
    seeds: int = 5,
    difficulties: Sequence[int] = (3, 2, 1, 0),
) -> AiTimesPlan:
    """Plans the races of :func:`measure_ai_times`, which describes the arguments."""
    names = find_tracks(tracks, RaceSettings())
    return AiTimesPlan(tracks=names, seeds=seeds, difficulties=tuple(difficulties))


AI_TIMES = BatchKind(
    AiTimesPlan,
    _orders,
    lambda _, results, __: AiTimes.from_races(results[number] for number in sorted(results)),
    written(AI_TIMES_FILE),
    is_partial=False,
)


def measure_ai_times(output: str | os.PathLike[str], **options: Any) -> AiTimes:
    """Measures the finish times of the game's AI in both directions, or resumes a measurement.

    Args:
        output: folder for the result of every race and ``ai_times.json``.
        options: ``tracks`` are names of tracks or of splits (by default, ``"all"``).
            ``seeds`` is the number of races with five karts for each track, direction and
            difficulty, and ``difficulties`` are the levels of the AI. Other options are arguments
            of :class:`~stkzoo.evaluation.RunOptions`.

    Raises:
        ConfigError: an argument is invalid, or ``output`` contains another batch.
        AssetError: the game's data is missing.
        BatchError: some races could not be run.
    """
    run, plan = RunOptions.split(options)
    return AI_TIMES.run(plan_ai_times(**plan), Path(output), run)
