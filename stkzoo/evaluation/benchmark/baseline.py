"""Measures how long the game's AI takes: races of five karts that it drives all."""

from __future__ import annotations

import itertools
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from stkzoo.errors import ConfigError, StkzooError, check_whole
from stkzoo.evaluation.batch import (
    RACE_TIMEOUT,
    BatchFolder,
    BatchKind,
    BatchRunner,
    ProgressListener,
    RaceOrder,
    errors_in_words,
    write_whole,
)
from stkzoo.evaluation.batch.plans import (
    find_tracks,
    read_form,
    what_changed,
    write_form,
)
from stkzoo.evaluation.benchmark.ai_times import AiTimes
from stkzoo.evaluation.benchmark.races import FRONT, race_seed
from stkzoo.race.result import versions_now
from stkzoo.race.settings import RaceSettings

__all__ = ["AI_TIMES_FILE", "measure_ai_times"]

AI_TIMES_FILE = "ai_times.json"
_KIND, _VERSION = "ai-times-plan", 1
_KARTS = 5
_DIFFICULTIES = (3, 2, 1, 0)
_MAX_SEEDS = 1000


@dataclass(frozen=True, slots=True)
class _Plan:
    tracks: tuple[str, ...]
    seeds: int
    difficulties: tuple[int, ...]
    versions: dict[str, str]

    def orders(self) -> list[RaceOrder]:
        kinds = itertools.product(self.difficulties, self.tracks, (False, True), range(self.seeds))
        return [
            RaceOrder(number, ("ai",) * _KARTS, _settings(*kind))
            for number, kind in enumerate(kinds)
        ]

    def to_json(self) -> str:
        return write_form(_KIND, _VERSION, asdict(self))

    @classmethod
    def from_json(cls, text: str) -> _Plan:
        form = read_form(text, _KIND, _VERSION)
        try:
            check_whole("seeds", form["seeds"], 1, _MAX_SEEDS)
            tracks, difficulties = tuple(form["tracks"]), tuple(form["difficulties"])
            return cls(tracks, form["seeds"], difficulties, form["versions"])
        except (KeyError, TypeError) as error:
            raise ConfigError(f"the plan cannot be read: {error}") from error

    def differences(self, other: _Plan) -> list[str]:
        return what_changed(_flat(self), _flat(other), ())


_BASELINE = BatchKind("measurement", _Plan.from_json, "stkzoo benchmark --baseline")


def _flat(plan: _Plan) -> dict[str, Any]:
    return {**asdict(plan), "versions": plan.versions.get("pystk2")}


def _settings(difficulty: int, track: str, reverse: bool, index: int) -> RaceSettings:
    return RaceSettings(
        track=track,
        reverse=reverse,
        difficulty=difficulty,
        seed=race_seed(track, reverse, "A" * _KARTS, FRONT, index),
        max_paths=1,  # nobody looks
    )


def measure_ai_times(
    output: str | os.PathLike[str],
    *,
    tracks: str | Sequence[str] = "all",
    seeds: int = 5,
    difficulties: Sequence[int] = _DIFFICULTIES,
    jobs: int | None = None,
    race_timeout: float = RACE_TIMEOUT,
    on_race: ProgressListener | None = None,
) -> AiTimes:
    """Races the game's AI against itself, in both directions, or goes on with that.

    Args:
        output: a folder of its own: every race, and in the end ``ai_times.json``.
        tracks: names, or ``"train"``, ``"test"`` or ``"all"``.
        seeds: how many races of five karts for each figure.
        difficulties: levels of the AI.
        jobs: how many races at a time; by default as many as there are processors.
        race_timeout: for one race [s].
        on_race: is told of every race.

    Raises:
        ConfigError: an argument cannot be, or ``output`` has something else.
        AssetError: the game's data is missing.
        StkzooError: some races could not be run.
    """
    runner = BatchRunner(jobs, race_timeout, on_race)
    check_whole("seeds", seeds, 1, _MAX_SEEDS)
    for difficulty in difficulties:
        check_whole("difficulty", difficulty, 0, 3)
    found = find_tracks(tracks, RaceSettings())
    plan = _Plan(found, seeds, tuple(difficulties), versions_now())
    with BatchFolder(_BASELINE, output) as folder:
        plan = folder.keep_plan(plan)
        results, errors = runner.run(folder, plan.orders())
        if errors:
            raise StkzooError(errors_in_words(errors, len(plan.orders())))
        times = AiTimes.from_races(results[number] for number in sorted(results))
        write_whole(folder.path / AI_TIMES_FILE, times.to_json() + "\n")
    return times
