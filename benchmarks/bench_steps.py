"""Compares the cost of a step of the bare engine, stkzoo and pystk2-gymnasium.

    python -m benchmarks.bench_steps
    python -m benchmarks.bench_steps --karts 3 10 --view full flattened --steps 300

All contenders run the same race with the same actions, a few steps each in turn, so that noise on
the machine affects all of them equally. The results state whether all karts drove the same
distance, bit for bit. The ratio of a step is its time over the time spent inside
``pystk2.Race.step`` in that step. Compilation and the first steps are not counted.

There are three groups. ``parallel`` is stkzoo's ParallelEnv in each view with all karts as agents,
also with events. ``multi`` is the id multi-full-v0 with all karts as agents, in stkzoo and in the
reference. ``single`` are the ids with one agent in each view of the
reference, in both; the game drives the other karts.

Actions of the views ``control`` and ``flattened_control`` are a speed and a steering angle. Their
controls depend on the kart's state to the last bit, so they have no ``engine`` contender and their
races are not compared.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.bench_common import (
    KARTS,
    REFERENCE_VIEWS,
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
from benchmarks.bench_controls import PHYSICAL, driving_style
from benchmarks.bench_driver import Spec, contenders, race_together

GROUPS = ("parallel", "multi", "single")


@dataclass(frozen=True)
class Lineup:
    """Contenders that run together.

    Attributes:
        group: one of :data:`GROUPS`.
        view: view of all contenders.
        num_kart: number of karts.
        specs: contenders by name.
    """

    group: str
    view: str
    num_kart: int
    specs: Mapping[str, Spec]


def matches(options: argparse.Namespace) -> Iterator[Lineup]:
    """Yields the lineups that the options select."""
    pinned = cores(options.cores)
    for num_kart in options.karts:
        for group in options.group:
            if group == "single" and num_kart not in options.single_karts:
                continue
            views = ("full",) if group == "multi" else options.view
            for view in views:
                if group == "single" and view not in REFERENCE_VIEWS:
                    continue
                specs = _specs(group, view, num_kart, pinned)
                yield Lineup(group, view, num_kart, specs)


def _specs(group: str, view: str, num_kart: int, pinned: tuple[int, ...]) -> dict[str, Spec]:
    def spec(kind: str, subprocess: bool = False, events: bool = False) -> Spec:
        num_agents = 1 if group == "single" else num_kart
        return Spec(kind, group, view, num_kart, num_agents, subprocess, pinned, events)

    specs = {} if driving_style(view) == PHYSICAL else {"engine": spec("bare")}
    specs |= {
        "stkzoo, in process": spec("stkzoo"),
        "stkzoo, worker": spec("stkzoo", subprocess=True),
    }
    if group == "parallel":
        specs["stkzoo, events"] = spec("stkzoo", events=True)
    # The reference's fixed-size views fail in a race without other karts.
    if group == "multi" or (group == "single" and (num_kart > 1 or view == "full")):
        specs["reference, in process"] = spec("reference")
        specs["reference, subprocess"] = spec("reference", subprocess=True)
    return specs


def run(match: Lineup, options: argparse.Namespace, advance: Any) -> dict[str, Any]:
    """Runs one lineup; returns its part of the results."""
    with contenders(match.specs) as started:
        times, is_same = race_together(
            started,
            track=options.track,
            steps=options.steps,
            driving=options.driving,
            advance=advance,
        )
    return {
        "group": match.group,
        "view": match.view,
        "karts": match.num_kart,
        "same_race": is_same if "engine" in times else None,
        "contenders": {name: figures(times[name], times.get("engine")) for name in match.specs},
    }


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = parser(__doc__, "steps", steps=300, karts=KARTS, cores=1)
    add_driving(words)
    words.add_argument("--view", nargs="+", choices=VIEWS, default=list(VIEWS))
    words.add_argument("--group", nargs="+", choices=GROUPS, default=list(GROUPS))
    words.add_argument(
        "--single-karts",
        type=int,
        nargs="+",
        default=[1, 3],
        metavar="K",
        help="numbers of karts for the single-kart ids (default: 1 3)",
    )
    options = words.parse_args(arguments)
    todo = list(matches(options))
    results = []
    with progress_bar(sum(len(match.specs) for match in todo) * options.steps) as (bar, task):
        for match in todo:
            bar.update(task, description=f"{match.group} {match.view}, {match.num_kart} karts")
            results.append(run(match, options, lambda count: bar.advance(task, count)))
    save(options.output, "steps", options, results, tables(results))
    return int(any(result["same_race"] is False for result in results))


def tables(results: Sequence[Mapping[str, Any]]) -> list[Table]:
    """Returns one table per group."""
    columns = ("", "view", "karts", "step", "in engine", "ratio", "added", "to bare", "same race")
    return [
        Table(
            f"{group}: one step [µs], median (10..90%)",
            columns,
            [row for result in results if result["group"] == group for row in _rows(result)],
        )
        for group in dict.fromkeys(result["group"] for result in results)
    ]


def _rows(result: Mapping[str, Any]) -> list[tuple[str, ...]]:
    return [
        (
            name,
            result["view"],
            str(result["karts"]),
            spread(found["step"]),
            spread(found.get("engine")),
            spread(found.get("ratio"), 3),
            spread(found.get("overhead")),
            f"{found['to_bare']:.3f}" if "to_bare" in found else "-",
            {True: "yes", False: "NO", None: "-"}[result["same_race"]],
        )
        for name, found in result["contenders"].items()
    ]


if __name__ == "__main__":
    sys.exit(main())
