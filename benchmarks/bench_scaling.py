"""Measures how the cost of a step grows with karts, items and the length of the path.

    python -m benchmarks.bench_scaling
    python -m benchmarks.bench_scaling --karts 1 10 100 --tracks lighthouse --steps 100

The benchmark first varies the number of karts on one track, then the track with a fixed number of
karts. It reports the time inside the engine, the time that stkzoo adds, and the engine's fraction
of the step. All karts are agents.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks.bench_common import (
    VIEWS,
    Table,
    add_driving,
    cores,
    figures,
    parser,
    progress_bar,
    save,
    spread,
)
from benchmarks.bench_driver import Spec, contenders, race_together
from stkzoo.tracks import SPLITS

ENGINE = "engine"


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "scaling", steps=100, karts=(1, 2, 3, 5, 10, 20, 50, 100), cores=1)
    add_driving(words)
    words.add_argument("--view", nargs="+", choices=VIEWS, default=["full", "flattened"])
    words.add_argument(
        "--tracks",
        nargs="*",
        choices=SPLITS["all"],
        default=list(SPLITS["all"]),
        metavar="NAME",
        help="tracks to compare (default: all)",
    )
    words.add_argument(
        "--track-karts", type=int, default=3, help="karts on each of --tracks (default: 3)"
    )
    options = words.parse_args(arguments)
    num_races = len(options.karts) + len(options.tracks)
    results = []
    with progress_bar(num_races * (1 + 2 * len(options.view)) * options.steps) as (bar, task):
        for karts, track, found in _races(options, lambda count: bar.advance(task, count)):
            bar.update(task, description=f"{karts} karts on {track} done")
            results.append(found)
    save(options.output, "scaling", options, results, tables(results))
    return int(not all(result["same_race"] for result in results))


def _races(
    options: argparse.Namespace, advance: Callable[[int], None]
) -> Iterator[tuple[int, str, dict[str, Any]]]:
    plan = [(karts, [options.track], "karts") for karts in options.karts]
    plan += [(options.track_karts, options.tracks, "tracks")] if options.tracks else []
    for karts, tracks, part in plan:
        with contenders(_specs(karts, options)) as started:
            for track in tracks:
                times, is_same = race_together(
                    started,
                    track=track,
                    steps=options.steps,
                    driving=options.driving,
                    advance=advance,
                )
                sizes = started[f"{options.view[0]}, in process"].ask("sizes")
                found = {name: figures(times[name], times[ENGINE]) for name in started}
                result = {"part": part, "karts": karts, "track": track, "same_race": is_same}
                yield karts, track, {**result, **sizes, "contenders": found}


def _specs(karts: int, options: argparse.Namespace) -> dict[str, Spec]:
    pinned = cores(options.cores)
    specs = {ENGINE: Spec("bare", num_kart=karts, num_agents=karts, cores=pinned)}
    for view in options.view:
        for where, subprocess in (("in process", False), ("worker", True)):
            name = f"{view}, {where}"
            specs[name] = Spec("stkzoo", "parallel", view, karts, karts, subprocess, pinned)
    return specs


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns a table of numbers of karts and one of tracks."""
    columns = (
        "",
        "karts",
        "track",
        "nodes",
        "items",
        "in engine",
        "added",
        "engine's share",
        "to bare",
    )
    titles = {"karts": "more karts", "tracks": "other tracks"}
    return [
        Table(f"{titles[part]}: one step [µs], median (10..90%)", columns, rows)
        for part in titles
        if (rows := [row for r in results if r["part"] == part for row in _rows(r)])
    ]


def _rows(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            str(result["karts"]),
            result["track"],
            str(result["path_nodes"]),
            str(result["items"]),
            spread(found.get("engine")),
            spread(found.get("overhead")),
            f"{100 / found['ratio']['median']:.0f}%" if "ratio" in found else "-",
            f"{found['to_bare']:.3f}",
        )
        for name, found in result["contenders"].items()
        if name != ENGINE
    ]


if __name__ == "__main__":
    sys.exit(main())
