"""Races the drivers of the suite's population against each other, for its cross-play matrix.

    python -m benchmarks.suite_crossplay              # continues if interrupted

Each race has six drivers on a validation track, in both directions, in a random order on the grid.
The drivers take turns. All AI karts of a race have the same difficulty, so AI drivers of different
difficulties never meet.
Writes ``benchmarks/results/suite_crossplay.json``: for each pair, the share of their races in which
the first finished ahead of the second, with 95% intervals over tracks and directions. Karts that
do not finish are ranked by distance. ``python -m benchmarks.bench_charts`` draws the matrix.
"""

from __future__ import annotations

import json
import random
import sys
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from stkzoo._arguments import CommandParser
from stkzoo._os import cpu_count, write_text
from stkzoo.evaluation.batch.order import RACES, RaceOrder, load_orders
from stkzoo.evaluation.batch.pool import run_in_parallel
from stkzoo.evaluation.statistics import estimate_clustered
from stkzoo.race.result import RaceResult
from stkzoo.race.settings import RaceSettings
from stkzoo.suite import POPULATION, SUITE, Member
from stkzoo.suite.population import draw_members
from stkzoo.suite.tasks import DIFFICULTY
from stkzoo.tracks import VALIDATION_TRACKS

from .bench_common import RESULTS

FILE = RESULTS / "suite_crossplay.json"
_KARTS = 6
_RACE_TIMEOUT = 600.0  # [s]


def plan(rounds: int, seed: int = 0) -> list[RaceOrder]:
    """Returns the races.

    Args:
        rounds: races on each track in each direction.
        seed: seed of the drivers and of the races.
    """
    chance = random.Random(seed)
    waiting: list[Member] = []
    levels = {member.driver: member.level for member in POPULATION if member.level is not None}
    orders = []
    places = [place for _ in range(rounds) for place in product(VALIDATION_TRACKS, (False, True))]
    for number, (track, reverse) in enumerate(places):
        drivers = [*draw_members(waiting, _KARTS, chance)]
        chance.shuffle(drivers)
        level = next((levels[name] for name in drivers if name in levels), DIFFICULTY)
        settings = RaceSettings(
            track=track, reverse=reverse, difficulty=level, seed=chance.randrange(2**31)
        )
        orders.append(RaceOrder(number, tuple(drivers), settings))
    return orders


def matrix(orders: Sequence[RaceOrder], results: dict[int, RaceResult]) -> list[dict[str, Any]]:
    """Returns how often each driver beats each of the others, with intervals.

    Args:
        orders: the races.
        results: their results by number.
    """
    names = [member.driver for member in POPULATION]
    places = sorted({(order.settings.track, order.settings.reverse) for order in orders})
    won = np.zeros((len(names), len(names), len(places)))
    met = np.zeros_like(won)
    for order in orders:
        place = places.index((order.settings.track, order.settings.reverse))
        rank = {row.source: row.rank for row in results[order.number].agents}
        for one, other in product(order.drivers, repeat=2):
            if one != other:
                cell = names.index(one), names.index(other), place
                met[cell] += 1
                won[cell] += rank[one] < rank[other]
    return [
        {"row": names[one], "column": names[other], "races": int(met[one, other].sum())}
        | asdict(share)
        for one, other in product(range(len(names)), repeat=2)
        if (share := estimate_clustered(won[one, other], met[one, other])) is not None
    ]


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.suite_crossplay", description=__doc__)
    words.add_argument("--rounds", type=int, default=24, help="races a track and direction")
    words.add_argument("--folder", type=Path, default=Path("runs/crossplay"), help="of the races")
    words.add_argument("--output", type=Path, default=FILE, help="JSON file to write")
    options = words.parse_args(arguments)
    (options.folder / RACES).mkdir(parents=True, exist_ok=True)
    orders = plan(options.rounds)
    results = load_orders(orders, options.folder)
    missing = [order for order in orders if order.number not in results]
    console = Console(stderr=True)
    races = run_in_parallel(missing, options.folder, cpu_count(), _RACE_TIMEOUT)
    with console.status("racing") as status, closing(races) as outcomes:
        for outcome in outcomes if missing else ():
            if outcome.error:
                console.print(f"race {outcome.order.number}: {outcome.error}")
                return 1
            number = outcome.order.number
            results[number] = outcome.order.store(options.folder, outcome.result)
            status.update(f"{len(results)} of {len(orders)} races")
    found = {"suite": SUITE, "rounds": options.rounds, "cells": matrix(orders, results)}
    write_text(options.output, json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
