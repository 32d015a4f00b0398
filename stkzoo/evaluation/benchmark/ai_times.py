"""How long the game's AI takes on every track: what times are compared with."""

from __future__ import annotations

import json
import math
import os
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stkzoo.errors import ConfigError
from stkzoo.evaluation.benchmark.races import direction_name
from stkzoo.race.result import RaceResult, check_form, read_json, versions_now

__all__ = ["SCHEMA_VERSION", "AiTime", "AiTimes", "load_ai_times"]

#: Of the JSON form (``docs/schemas/ai-times.schema.json``).
SCHEMA_VERSION = 1
_TYPE = "ai-times"
_FILE = Path(__file__).parent / "ai_times.json"

Key = tuple[str, bool, int]


@dataclass(frozen=True, slots=True)
class AiTime:
    """The AI's finish times on one track, in one direction, at one difficulty.

    Attributes:
        median: of all karts, those that did not finish being the slowest [s].
        best: the shortest [s].
        worst: the longest of those that finished [s].
        karts: how many karts drove.
        finished: how many of them finished.
    """

    median: float
    best: float
    worst: float
    karts: int
    finished: int

    @classmethod
    def of(cls, times: Sequence[float | None]) -> AiTime | None:
        """The figures of some finish times; ``None`` if most karts did not finish."""
        finished = [time for time in times if time is not None]
        median = statistics.median([math.inf if time is None else time for time in times])
        if not math.isfinite(median):
            return None
        return cls(
            median=round(median, 3),
            best=round(min(finished), 3),
            worst=round(max(finished), 3),
            karts=len(times),
            finished=len(finished),
        )


@dataclass(frozen=True)
class AiTimes:
    """The AI's times.

    Attributes:
        by_race: by track, reversed and difficulty.
        versions: of the software that measured them.
    """

    by_race: Mapping[Key, AiTime]
    versions: Mapping[str, str]

    def of(self, track: str, reverse: bool, difficulty: int) -> AiTime:
        """The times on one track.

        Raises:
            ConfigError: they have not been measured.
        """
        try:
            return self.by_race[track, reverse, difficulty]
        except KeyError:
            raise ConfigError(
                f"the game's AI has no time on {track} ({direction_name(reverse)}) at difficulty "
                f"{difficulty}; measure it: stkzoo benchmark --baseline --split {track} --output "
                "ai-times, and give --ai-times ai-times/ai_times.json"
            ) from None

    @classmethod
    def from_races(cls, results: Iterable[RaceResult]) -> AiTimes:
        """The times in races of which all drivers were the AI."""
        times: dict[Key, list[float | None]] = {}
        for result in results:
            of_race = times.setdefault((result.track, result.reverse, result.difficulty), [])
            of_race.extend(row.finish_time for row in result.agents)
        found = {key: AiTime.of(times[key]) for key in sorted(times)}
        return cls({key: time for key, time in found.items() if time is not None}, versions_now())

    def to_json(self) -> str:
        """The times as JSON, one line a time."""
        lines = [
            json.dumps(
                {
                    "track": track,
                    "direction": direction_name(reverse),
                    "difficulty": difficulty,
                    **asdict(time),
                }
            )
            for (track, reverse, difficulty), time in self.by_race.items()
        ]
        head = {"type": _TYPE, "schema_version": SCHEMA_VERSION, "versions": dict(self.versions)}
        rows = ",\n    ".join(lines)
        return json.dumps(head, indent=2)[:-2] + f',\n  "times": [\n    {rows}\n  ]\n}}'

    @classmethod
    def from_json(cls, text: str) -> AiTimes:
        """Reads what :meth:`to_json` wrote.

        Raises:
            ConfigError: it is something else, or of another version.
        """
        try:
            form = read_json(text)
            check_form(form, _TYPE, SCHEMA_VERSION)
            return cls(dict(map(_entry, form["times"])), form["versions"])
        except (KeyError, TypeError, json.JSONDecodeError) as error:
            raise ConfigError(
                f"the text has no times of the game's AI ({type(error).__name__}: {error}); "
                "expected what `stkzoo benchmark --baseline` wrote"
            ) from error


def _entry(form: dict[str, Any]) -> tuple[Key, AiTime]:
    key = form.pop("track"), form.pop("direction") == direction_name(True), form.pop("difficulty")
    return key, AiTime(**form)


def load_ai_times(path: str | os.PathLike[str] | None = None) -> AiTimes:
    """The AI's times.

    Args:
        path: a file that ``stkzoo benchmark --baseline`` wrote; by default the one that comes
            with stkzoo.

    Raises:
        ConfigError: it cannot be read.
    """
    file = _FILE if path is None else Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"the AI's times {file} cannot be read: {error}") from error
    return AiTimes.from_json(text)
