"""The finish times of the game's AI on every track, to which benchmarks compare an agent's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, ClassVar

from stkzoo._schema import Level, Positive, Whole, one_of
from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.races import direction_name
from stkzoo.race.document import Document

#: The times that come with stkzoo.
SHIPPED_FILE = Path(__file__).with_name("ai_times.json")

#: Track, ``reverse`` and difficulty.
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


@dataclass(frozen=True)
class AiTimes(Document):
    """The AI's finish times on several tracks.

    Attributes:
        versions: versions of the software with which they were measured.
        times: the times for each track, direction and difficulty.
    """

    # docs/schemas/ai-times.schema.json
    type_name: ClassVar[str] = "ai-times"
    origin: ClassVar[str] = "the --output of `python -m benchmarks.ai_times`"
    rows: ClassVar[str] = "times"

    versions: Mapping[str, str]
    times: tuple[AiTime, ...]

    @cached_property
    def by_race(self) -> dict[RaceKey, AiTime]:
        """The times, by track, ``reverse`` and difficulty."""
        return {(t.track, t.direction == "reversed", t.difficulty): t for t in self.times}

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
                f"{difficulty}; choose one of the tracks of `stkzoo tracks`"
            ) from None


@cache
def load_ai_times() -> AiTimes:
    """Returns the AI's finish times that come with stkzoo."""
    return AiTimes.load(SHIPPED_FILE)
