"""List the tracks.

Shows the game's tracks: the length of a lap, the segments and forks of the driving line, the
items at the start, the lap time of the game's AI, forward and reversed (median of 25 karts at
--difficulty), and the human world record in the game's time trial with its number of laps. Do not
train on the tracks of "test".

Examples:
  stkzoo tracks                                    all tracks by name
  stkzoo tracks train --sort time                  the shortest times first
  stkzoo tracks lighthouse hacienda --difficulty 3
  stkzoo tracks lighthouse --map lighthouse.png    draw a map
  stkzoo tracks --json                             JSON output for programs
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.progress import BarColumn, TextColumn

from stkzoo import race_v0
from stkzoo._arguments import changed_options, option, positional, refuse_options
from stkzoo._os import write_whole
from stkzoo.cli._console import make_bars, show_table
from stkzoo.errors import ConfigError
from stkzoo.evaluation import load_ai_times
from stkzoo.evaluation.batch.plan import find_tracks
from stkzoo.race import RaceSettings
from stkzoo.records import HUMAN_RECORDS
from stkzoo.render.map import MapView
from stkzoo.render.pictures import pillow
from stkzoo.tracks import split_of

#: Field to sort by, for each choice of ``--sort``.
_SORTS = {"name": "track", "length": "length", "time": "time", "items": "items"}


@dataclass
class TracksArguments:
    """Options of ``stkzoo tracks``.

    Attributes:
        tracks: names of tracks, or train, train_only, validation, test or all (default: all)
        sort: sort order
        difficulty: difficulty of the AI whose times are shown, 0 to 3
        map: draw a map of one track to FILE (.png, .jpg, .webp)
        json: write JSON instead of a table
    """

    tracks: tuple[str, ...] = positional((), metavar="TRACK")
    sort: str = option("name", choices=_SORTS)
    difficulty: int = option(2, choices=range(4), metavar="N")
    map: Path | None = option(metavar="FILE")
    json: bool = False


@dataclass(frozen=True)
class TrackFacts:
    """Facts about one track.

    Attributes:
        track: name of the track.
        split: ``"train"``, ``"validation"`` (also a training track) or ``"test"``.
        length: length of a lap [m].
        segments: number of segments of the driving line.
        forks: number of segments with several successors.
        items: number of items at the start.
        time: the AI's median time for a lap, forward [s]; ``None`` if not measured.
        reversed_time: the AI's median time for a lap, reversed [s]; ``None`` if not measured.
        record: the human world record [s]; ``None`` if unknown (:mod:`stkzoo.records`).
        record_laps: number of laps of the record; ``None`` if unknown.
    """

    track: str
    split: str
    length: float
    segments: int
    forks: int
    items: int
    time: float | None
    reversed_time: float | None
    record: float | None
    record_laps: int | None


def run(arguments: TracksArguments) -> int:
    """Prints a table or JSON, or draws a map."""
    names = find_tracks(arguments.tracks or "all", RaceSettings())
    if arguments.map is not None:
        options = changed_options(arguments, only=("sort", "difficulty", "json"))
        refuse_options("--map only draws a map", options)
        return _draw(names, arguments.map)

    with make_bars(TextColumn("{task.description}"), BarColumn()) as bars:
        tracks = bars.track(names, description="reading the tracks")
        facts = [track_facts(name, arguments.difficulty) for name in tracks]
    facts.sort(key=lambda fact: getattr(fact, _SORTS[arguments.sort]) or 0.0)
    if arguments.json:
        print(json.dumps([asdict(fact) for fact in facts], indent=2))
    else:
        _write_table(facts, arguments.difficulty)
    return 0


def track_facts(track: str, difficulty: int) -> TrackFacts:
    """Returns facts about a track, which it reads from a race that it starts.

    Args:
        track: name of the track.
        difficulty: level of the AI whose times are included, 0 to 3.
    """
    with race_v0.parallel_env(num_kart=1, track=track, max_paths=1) as env:
        env.reset(seed=0)
        road, snapshot = env.track_map, env.snapshot
        assert road is not None  # noqa: S101 - there is a race
        assert snapshot is not None  # noqa: S101
        times = load_ai_times().by_race
        record = HUMAN_RECORDS.get(track)
        medians = [times.get((track, reverse, difficulty)) for reverse in (False, True)]
        return TrackFacts(
            track=track,
            split=split_of(track),
            length=round(road.length, 2),
            segments=road.num_nodes,
            forks=sum(len(nodes) > 1 for nodes in road.successors),
            items=len(snapshot.items),
            time=medians[0].median if medians[0] else None,
            reversed_time=medians[1].median if medians[1] else None,
            record=record.seconds if record else None,
            record_laps=record.laps if record else None,
        )


def _write_table(facts: Sequence[TrackFacts], difficulty: int) -> None:

    columns = (
        *("track", "split", "length [m]", "segments", "forks", "items"),
        *("AI [s]", "reversed", "record"),
    )
    rows = []
    for fact in facts:
        numbers = (round(fact.length), fact.segments, fact.forks, fact.items)
        times = ("-" if t is None else f"{t:.1f}" for t in (fact.time, fact.reversed_time))
        record = f"{fact.record:.1f}/{fact.record_laps}" if fact.record else "-"
        rows.append((fact.track, fact.split, *map(str, numbers), *times, record))
    caption = f"AI times at difficulty {difficulty}; human world records [s] / their laps"
    show_table(columns, rows, left=columns[:2], caption=caption)


def _draw(names: Sequence[str], file: Path) -> int:
    if len(names) != 1:
        raise ConfigError(
            f"--map draws one track, and {len(names)} are named; for example "
            "`stkzoo tracks lighthouse --map lighthouse.png`"
        )
    if file.suffix.lower() not in (".png", ".jpg", ".jpeg", ".webp"):
        raise ConfigError(f"--map is {str(file)!r}, expected a name ending in .png, .jpg or .webp")

    with race_v0.parallel_env(num_kart=1, track=names[0]) as env:
        env.reset(seed=0)
        scene, snapshot = env.scene, env.snapshot
        assert scene is not None  # noqa: S101 - there is a race
        assert snapshot is not None  # noqa: S101
        picture = MapView(scene, (1024, 768), panel=False).draw(snapshot)
    image, formats = pillow().Image.fromarray(picture), pillow().Image.registered_extensions()
    with write_whole(file) as part:
        image.save(part, format=formats[file.suffix.lower()])
    print(file)
    return 0
