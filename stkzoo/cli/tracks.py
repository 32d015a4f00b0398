"""List the tracks.

Shows the game's tracks: the length of a lap, the segments and forks of the driving line, the
items at the start, the lap time of the game's AI, forward and reversed (median of 25 karts at
--difficulty), and the human world record in the game's time trial with its number of laps. Do not
train on the tracks of "test".

Examples:
  stkzoo tracks                                    all tracks by name
  stkzoo tracks lighthouse hacienda --difficulty 3
  stkzoo tracks --json                             JSON output for programs
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from stkzoo import race_v0
from stkzoo._arguments import option, positional
from stkzoo.cli._console import Bars, show, show_facts
from stkzoo.evaluation import load_ai_times
from stkzoo.evaluation.batch.plan import find_tracks
from stkzoo.race import RaceSettings
from stkzoo.records import HUMAN_RECORDS
from stkzoo.tracks import split_of


@dataclass
class TracksArguments:
    """Options of ``stkzoo tracks``.

    Attributes:
        tracks: names of tracks, or train, train_only, validation, test or all (default: all)
        difficulty: difficulty of the races of the AI; it sets the speed of all karts, 0 to 3
        json: write JSON instead of a table
    """

    tracks: tuple[str, ...] = positional((), metavar="TRACK")
    difficulty: int = option(2, choices=range(4), metavar="N")
    json: bool = False


def run(arguments: TracksArguments) -> None:
    """Prints a table or JSON."""
    names = find_tracks(arguments.tracks or "all", RaceSettings())
    facts: list[dict[str, Any]] = []
    with Bars() as bars:
        bars.begin("reading the tracks", len(names))
        for name in names:
            bars.show(len(facts), name)
            facts.append(track_facts(name, arguments.difficulty))
    title = f"Lengths in m; times in s, at difficulty {arguments.difficulty}; human world records"
    show(facts, partial(show_facts, title=title), as_json=arguments.json)


def track_facts(track: str, difficulty: int) -> dict[str, Any]:
    """Returns facts about a track, which it reads from a race that it starts.

    Args:
        track: name of the track.
        difficulty: difficulty of the races of the AI, 0 to 3.

    Returns:
        ``track``, its name; ``split``: ``"train"``, ``"validation"`` (also a training track) or
        ``"test"``; ``length``, the length of a lap [m]; ``segments``, the number of segments of the
        driving line; ``forks``, the number of those with several successors; ``items``, the number
        of items at the start; ``time`` and ``reversed_time``, the AI's median times for a lap [s],
        ``None`` if not measured; ``record`` [s] and ``record_laps``, the human world record
        (:mod:`stkzoo.records`), ``None`` if unknown.
    """
    with race_v0.parallel_env(num_kart=1, track=track, max_paths=1) as env:
        env.reset(seed=0)
        road, snapshot = env.track_map, env.snapshot
        assert road is not None  # noqa: S101 - there is a race
        assert snapshot is not None  # noqa: S101
        times = load_ai_times().by_race
        record = HUMAN_RECORDS.get(track)
        medians = [times.get((track, reverse, difficulty)) for reverse in (False, True)]
        return {
            "track": track,
            "split": split_of(track),
            "length": round(road.length, 2),
            "segments": road.num_nodes,
            "forks": sum(len(nodes) > 1 for nodes in road.successors),
            "items": len(snapshot.items),
            "time": medians[0].median if medians[0] else None,
            "reversed_time": medians[1].median if medians[1] else None,
            "record": record.seconds if record else None,
            "record_laps": record.laps if record else None,
        }
