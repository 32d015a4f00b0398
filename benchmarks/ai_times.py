"""Measures the finish times of the game's AI, to which `stkzoo benchmark` compares agents.

    python -m benchmarks.ai_times                         # 840 races; continues if interrupted
    python -m benchmarks.ai_times --tracks olivermath --seeds 1 --output times.json

Five karts of the AI race on each track, in both directions, at each difficulty. Writes
``stkzoo/evaluation/benchmark/ai_times.json``, which comes with stkzoo.
"""

from __future__ import annotations

import itertools
import math
import statistics
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.console import Console

from benchmarks.common import parser, positive
from stkzoo._os import write_text
from stkzoo.evaluation import AiTime, AiTimes, BatchProgress, RunOptions
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.batch.plan import BatchPlan, find_tracks
from stkzoo.evaluation.batch.run import BatchKind
from stkzoo.evaluation.benchmark.ai_times import SHIPPED_FILE, RaceKey
from stkzoo.evaluation.benchmark.races import FRONT, direction_name, race_seed
from stkzoo.race import RaceResult, RaceSettings
from stkzoo.race.result import versions_now

_KARTS = 5
_DIFFICULTIES = (3, 2, 1, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class AiTimesPlan(BatchPlan):
    """The plan of races in which the game's AI drives all karts, in both directions.

    Attributes:
        seeds: number of races for each track, direction and difficulty.
        difficulties: levels of the AI.
    """

    type_name: ClassVar[str] = "ai-times-plan"
    noun: ClassVar[str] = "measurement"
    resume_command: ClassVar[str] = "python -m benchmarks.ai_times --folder {folder}"

    seeds: int
    difficulties: tuple[int, ...]

    def orders(self) -> list[RaceOrder]:
        """Returns the orders of all races."""
        races = itertools.product(self.difficulties, self.tracks, (False, True), range(self.seeds))
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


def times_of(results: Iterable[RaceResult]) -> AiTimes:
    """Returns the times from the results of races in which the AI drove all karts."""
    times: dict[RaceKey, list[float | None]] = {}
    for result in results:
        of_race = times.setdefault((result.track, result.reverse, result.difficulty), [])
        of_race += [row.finish_time for row in result.agents]
    known = (ai_time(race, times[race]) for race in sorted(times))
    return AiTimes(versions_now(), tuple(time for time in known if time is not None))


def ai_time(key: RaceKey, times: Sequence[float | None]) -> AiTime | None:
    """Returns the statistics of finish times.

    Args:
        key: track, ``reverse`` and difficulty.
        times: finish times of the karts of all races [s]; ``None`` for a kart that did not finish.

    Returns:
        The statistics; ``None`` if the median is unknown because too few karts finished.
    """
    track, reverse, difficulty = key
    finished = [time for time in times if time is not None]
    median = statistics.median([math.inf if time is None else time for time in times])
    if not math.isfinite(median):
        return None
    return AiTime(
        track=track,
        direction=direction_name(reverse),
        difficulty=difficulty,
        median=round(median, 3),
        best=round(min(finished), 3),
        worst=round(max(finished), 3),
        karts=len(times),
        finished=len(finished),
    )


MEASUREMENT = BatchKind(
    AiTimesPlan,
    lambda _, results, __: times_of(results[number] for number in sorted(results)),
    lambda *_: None,
    is_partial=False,
)


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser("ai_times", __doc__)
    words.add_argument("--tracks", nargs="+", default=["all"], help="tracks or splits")
    words.add_argument("--seeds", type=positive, default=5, help="races of each track and way")
    words.add_argument("--difficulties", nargs="+", type=int, default=_DIFFICULTIES)
    words.add_argument("--jobs", type=positive, help="races at the same time")
    words.add_argument("--folder", type=Path, default=Path("runs/ai-times"), help="of the races")
    words.add_argument("--output", type=Path, default=SHIPPED_FILE, help="JSON file to write")
    options = words.parse_args(arguments)
    plan = AiTimesPlan(
        tracks=find_tracks(options.tracks, RaceSettings()),
        seeds=options.seeds,
        difficulties=tuple(options.difficulties),
    )
    with Console(stderr=True).status("races") as status:

        def show(progress: BatchProgress) -> None:
            status.update(f"{progress.done} of {progress.total} races")

        times = MEASUREMENT.run(plan, options.folder, RunOptions(options.jobs, on_race=show))
    write_text(options.output, times.to_json() + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
