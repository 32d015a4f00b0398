"""Checks the conduct measure with a rammer, and measures ordinary drivers.

    python -m benchmarks.conduct              # continues if interrupted
    python -m benchmarks.conduct --races 4 --blind 2 --ordinary 2 --output /tmp/conduct.json

A scripted rammer chases drivers that avoid other karts (*ace*, *scout*, *apex* and the game's AI)
on the training tracks, in both directions. A *ram* is a contact before which the rammer moves
toward the other kart faster than the other kart toward the rammer. The rammer should be at fault in
at least 95% of its rams, and its victims in at most 2%. The rule for faults uses the same speeds,
so this checks the rule's design and not its accuracy. Further races have victims that ignore
other karts, or no rammer. The command writes ``benchmarks/results/conduct.json``. Rates have 95%
intervals over tracks.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bench_common import RESULTS, Table, print_tables, progress_bar
from benchmarks.conduct_races import GROUPS, RAMMER, JudgedRaceOrder, orders
from stkzoo._arguments import CommandParser
from stkzoo._os import cpu_count, write_text
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.statistics import estimate_clustered
from stkzoo.suite import RaceConduct

#: Returns whether a contact counts for a rate, from the names of the driver and of the other one,
#: and from how much faster the driver moves toward the other one than that one toward it [m/s].
Selection = Callable[[str, str, float], bool]
_GOALS = {"rams": 0.95, "victims of rams": 0.02}


def judged_races(
    folder: Path, planned: Sequence[JudgedRaceOrder], jobs: int | None
) -> list[RaceConduct]:
    """Runs and judges the races that are not stored in a folder yet; returns all."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {order.number: folder / f"{order.number:05d}.json" for order in planned}
    left = [order for order in planned if not files[order.number].exists()]
    running = run_in_parallel(left, folder, jobs or cpu_count(), 3600.0)
    with progress_bar(len(left)) as (bar, task), closing(running) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                print(f"race {outcome.order.number}: {outcome.error}", file=sys.stderr)
            else:
                write_text(files[outcome.order.number], outcome.result + "\n")
            bar.advance(task)
    return [RaceConduct.load(file) for file in files.values() if file.exists()]


def rate(races: Iterable[RaceConduct], selects: Selection) -> dict[str, Any]:
    """Returns the share of contacts at fault of the selected drivers, over tracks."""
    totals: dict[str, list[int]] = {}
    starts: list[float] = []
    for race in races:
        sources = [kart.source for kart in race.karts]
        for contact in race.contacts:
            lead = contact.closing[0] - contact.closing[1]
            for number, other, own_lead in ((*contact.karts, lead), (*contact.karts[::-1], -lead)):
                if selects(sources[number], sources[other], own_lead):
                    own = totals.setdefault(race.track, [0, 0])
                    own[0] += number == contact.at_fault
                    own[1] += 1
                    latest = contact.latest[contact.karts.index(number)]
                    starts += [latest] if latest and number == contact.at_fault else []
    faults, counts = np.array([*totals.values()], float).reshape(-1, 2).T
    found = estimate_clustered(faults, counts)
    return {
        "contacts": int(counts.sum()),
        "at_fault": int(faults.sum()),
        "rate": found and asdict(found),
        "median_start": float(np.median(starts)) if starts else None,
    }


def rates(group: str, races: Sequence[RaceConduct]) -> dict[str, Any]:
    """Returns the rates of a group of races: of the rammer, of its victims, and without it."""
    others = [driver for driver in dict.fromkeys(GROUPS[group]) if driver != RAMMER]
    judged = [driver for driver in others if driver != "ai"]

    def among(own: Sequence[str], other: Sequence[str]) -> dict[str, Any]:
        return rate(races, lambda one, two, _: one in own and two in other)

    if RAMMER not in GROUPS[group]:
        found = {"among_others": among(judged, others)}
        return found | {f"among_others: {driver}": among([driver], others) for driver in judged}
    found = {
        "rams": rate(races, lambda one, _, lead: one == RAMMER and lead > 0),
        "victims of rams": rate(
            races, lambda one, two, lead: one in judged and two == RAMMER and lead < 0
        ),
        "rammer": among([RAMMER], others),
        "victims": among(judged, [RAMMER]),
    }
    found |= {f"rammer with {driver}": among([RAMMER], [driver]) for driver in others}
    return found | {f"victims: {driver}": among([driver], [RAMMER]) for driver in judged}


def _row(name: str, found: dict[str, Any]) -> list[str]:
    share = found["rate"]
    if share is None:
        return [name, "0", "", ""]
    low, high = share["low"], share["high"]
    interval = "" if low is None else f"{100 * low:.1f} to {100 * high:.1f}%"
    return [name, str(found["contacts"]), f"{100 * share['value']:.1f}%", interval]


def _show(group: str, found: dict[str, Any]) -> None:
    rows = [_row(name, value) for name, value in found.items()]
    print_tables([Table(group, ("driver", "contacts", "at fault", "95%"), rows)])


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.conduct", description=__doc__)
    words.add_argument("--races", type=int, default=96, help="races with the rammer")
    words.add_argument("--blind", type=int, default=16, help="races whose victims ignore it")
    words.add_argument("--ordinary", type=int, default=10, help="races without it")
    words.add_argument("--jobs", type=int, help="races at the same time (default: all cores)")
    words.add_argument("--folder", type=Path, default=Path("runs/conduct"), help="of the races")
    words.add_argument("--output", type=Path, default=RESULTS / "conduct.json", metavar="FILE")
    options = words.parse_args(argv)
    counts = zip(GROUPS, (options.races, options.blind, options.ordinary), strict=True)
    found: dict[str, Any] = {}
    for group, count in counts:
        races = judged_races(options.folder / group, orders(group, count), options.jobs)
        found[group] = {"races": len(races), **rates(group, races)}
        _show(group, {name: value for name, value in found[group].items() if name != "races"})
    is_met = {
        "rams": _value(found, "rams") >= _GOALS["rams"],
        "victims of rams": _value(found, "victims of rams") <= _GOALS["victims of rams"],
    }
    result = {"goals": _GOALS, "is_met": is_met, **found}
    write_text(options.output, json.dumps(result, indent=1) + "\n")
    print("goals:", ", ".join(f"{name} {'met' if m else 'missed'}" for name, m in is_met.items()))
    return 0


def _value(found: dict[str, Any], name: str) -> float:
    share = found["rammer"][name]["rate"]
    return math.nan if share is None else float(share["value"])


if __name__ == "__main__":
    sys.exit(main())
