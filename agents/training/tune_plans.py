"""Finds better numbers for the plans of the heuristic and the learned drivers.

    python -m stkzoo.agents.training.tune_plans --output tuned --generations 60

CMA-ES (Hansen, "The CMA Evolution Strategy: A Tutorial", 2016; library ``cma``) asks for sets of
:class:`~stkzoo.agents.planning.DriverParameters` around its present mean, and is told how well
each drove: the mean logarithm of its time over the game AI's median time there. In a generation
all sets drive the same races on all training tracks, both ways, by the plans alone and many races
side by side. Alone by default: then a race tells nothing but how well it was driven, where in
company who hits whom decides more than the numbers do. The test tracks of :mod:`stkzoo.tracks`
are never driven.

The folder has ``log.jsonl``, a line a generation with all that was asked and told, from which
the same command goes on exactly, also after a kill; and ``best.json``, the mean's parameters.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import atomic_write
from stkzoo.agents.planning import DriverParameters
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.errors import ConfigError
from stkzoo.tracks import TRAIN_TRACKS

from .common.arguments import keep_to_one_thread, training_library
from .common.fleet import Beginning, Fleet, RaceForm

__all__ = ["BOUNDS", "drive_all", "from_unit", "main", "to_unit"]

#: What is tuned, and between which values.
BOUNDS: dict[str, tuple[float, float]] = {
    "wheel_base": (0.8, 1.2),
    "aim_distance": (1.0, 10.0),
    "aim_time": (0.1, 0.7),
    "margin": (0.0, 2.0),
    "greatest_room": (2.5, 7.5),
    "over_cost": (5.0, 50.0),
    "late_time": (0.0, 0.8),
    "late_cost": (0.0, 10.0),
    "angle_cost": (0.0, 15.0),
    "drift_speed": (10.0, 20.0),
    "boost_worth": (2.0, 24.0),
    "big_boost_worth": (4.0, 36.0),
    "boost_wait_cost": (0.0, 4.0),
    "small_nitro_worth": (0.0, 20.0),
    "big_nitro_worth": (0.0, 40.0),
    "banana_cost": (2.0, 30.0),
    "item_radius": (0.4, 1.6),
    "bad_item_radius": (0.6, 2.2),
    "caution_room": (0.5, 4.0),
    "nitro_turn": (0.2, 1.2),
    "danger": (0.1, 8.0),
    "nitro_wait": (0.8, 4.0),
}

#: A kart that does not finish counts as having taken so many times the AI's time.
_UNFINISHED = 3.0
#: Races of learning and of judging begin with other numbers.
_FIRST_NUMBER = 5000
#: So many sets drive at a time: one thinks while the others' games move.
_LANES = 2
_LOG, _BEST = "log.jsonl", "best.json"


def from_unit(point: Sequence[float]) -> DriverParameters:
    """The parameters that a point of the unit cube stands for; it is moved into the cube."""
    values: dict[str, Any] = {
        name: low + min(max(float(share), 0.0), 1.0) * (high - low)
        for (name, (low, high)), share in zip(BOUNDS.items(), point, strict=True)
    }
    return DriverParameters(**values)


def to_unit(parameters: DriverParameters) -> list[float]:
    """The point of the unit cube that stands for parameters."""
    return [
        (getattr(parameters, name) - low) / (high - low) for name, (low, high) in BOUNDS.items()
    ]


class _Lane:
    """Races side by side, driven by one set after another."""

    def __init__(self, form: RaceForm, beginnings: Sequence[Beginning], lane: _Lane | None) -> None:
        self._beginnings = beginnings
        self._fleet: Fleet = Fleet(
            [form] * len(beginnings),
            [track for track, *_ in beginnings],
            0,
            parked=lane._fleet.parked if lane else None,
            goes_on=False,
        )
        self._choose = RacingPolicy.of_plans_alone().best
        self.number: int | None = None

    def begin(self, number: int, parameters: DriverParameters) -> None:
        """A set of this number begins."""
        self.number, self._ratios = number, list[float]()
        self._fleet.set_rules(parameters)
        view = self._fleet.begin_at(self._beginnings)
        self._fleet.send(self._choose(view))

    def step(self) -> float | None:
        """A step; how well the set drove, once all its races are over."""
        view, outcome = self._fleet.receive()
        for finish in outcome.finishes:
            self._ratios.append(math.log(finish.ratio or _UNFINISHED))
        if self._fleet.active.any():
            self._fleet.send(self._choose(view))
            return None
        self.number = None
        return float(np.mean(self._ratios))

    def close(self, *, with_parked: bool) -> None:
        self._fleet.close(with_parked=with_parked)


def drive_all(
    sets: Sequence[DriverParameters], form: RaceForm, beginnings: Sequence[Beginning]
) -> list[float]:
    """How well each set drives: the mean logarithm of its times over the AI's median times.

    Args:
        sets: the parameters.
        form: who drives in each race.
        beginnings: the races.
    """
    lanes = [_Lane(form, beginnings, None)]
    lanes += [_Lane(form, beginnings, lanes[0]) for _ in range(min(_LANES, len(sets)) - 1)]
    told = [0.0] * len(sets)
    waiting = list(range(len(sets)))
    try:
        while waiting or any(lane.number is not None for lane in lanes):
            for lane in lanes:
                if lane.number is None:
                    if waiting:
                        lane.begin(waiting[0], sets[waiting.pop(0)])
                    continue
                number, value = lane.number, lane.step()
                if value is not None:
                    told[number] = value
    finally:
        for lane in reversed(lanes):
            lane.close(with_parked=lane is lanes[0])
    return told


class _Search:
    """The strategy and its log."""

    def __init__(self, options: argparse.Namespace) -> None:
        cma = training_library("cma")
        keep_to_one_thread()
        self.folder = Path(options.output)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.options = options
        self._form = RaceForm(1, options.rivals)
        self._strategy = cma.CMAEvolutionStrategy(
            to_unit(DriverParameters()),
            options.sigma,
            {
                "bounds": [0.0, 1.0],
                "popsize": options.population,
                "seed": options.seed + 1,
                "verbose": -9,
            },
        )
        self.generation = 0
        for line in self._lines():
            self._strategy.ask()
            self._strategy.tell(line["asked"], line["told"])
            self.generation += 1

    def run_one(self) -> dict[str, Any]:
        """One generation; its line of the log."""
        number = _FIRST_NUMBER + 1000 * self.options.seed + self.generation
        places = itertools.product(self.options.tracks, (False, True))
        beginnings = [(track, reverse, number) for track, reverse in places]
        asked = [list(map(float, point)) for point in self._strategy.ask()]
        points = [*asked, to_unit(DriverParameters())]  # the last one is for comparison
        *told, default = drive_all([from_unit(p) for p in points], self._form, beginnings)
        self._strategy.tell(asked, told)
        line = {
            "generation": self.generation,
            "asked": asked,
            "told": told,
            "default": default,
            "number": number,
        }
        self.generation += 1
        with (self.folder / _LOG).open("a") as log:
            log.write(json.dumps(line) + "\n")
        mean = from_unit(list(map(float, self._strategy.result.xfavorite)))
        with atomic_write(self.folder / _BEST) as part:
            part.write_text(json.dumps(asdict(mean), indent=1) + "\n")
        return line

    def _lines(self) -> list[dict[str, Any]]:
        file = self.folder / _LOG
        return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.tune_plans",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", default="tuned", help="folder (default: tuned)")
    parser.add_argument(
        "--generations", type=int, default=40, help="there shall be in all (default: 40)"
    )
    parser.add_argument("--population", type=int, default=14, help="sets each (default: 14)")
    parser.add_argument("--rivals", type=int, default=0, help="of the game's AI (default: 0)")
    parser.add_argument("--sigma", type=float, default=0.07, help="first step, of the ranges")
    parser.add_argument("--seed", type=int, default=0, help="(default: 0)")
    parser.add_argument(
        "--tracks",
        nargs="+",
        choices=TRAIN_TRACKS,
        default=[track for track in TRAIN_TRACKS if track != "black_forest"],
        help="training tracks (default: all but black_forest, which takes long)",
    )
    options = parser.parse_args(words)
    try:
        search = _Search(options)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    while search.generation < options.generations:
        begin = time.perf_counter()
        line = search.run_one()
        told = line["told"]
        print(
            f"generation {line['generation']}: time ratio "
            f"{math.exp(sum(told) / len(told)):.4f} on average, {math.exp(min(told)):.4f} at "
            f"best, {math.exp(line['default']):.4f} with the present numbers; "
            f"{time.perf_counter() - begin:.0f} s",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
