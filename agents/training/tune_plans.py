"""Tunes the parameters of the plans that the heuristic and the learned drivers use.

    python -m stkzoo.agents.training.tune_plans --output tuned --generations 60

CMA-ES (Hansen, "The CMA Evolution Strategy: A Tutorial", 2016; library ``cma``) proposes sets of
:class:`~stkzoo.agents.planning.parameters.DriverParameters` around its current mean. The loss of a
set is the mean logarithm of its race time over the game AI's median time. In a generation, all sets
drive the same races on all training tracks, in both directions, with the plans only, and in
parallel. By default each kart drives alone, because collisions would have more influence than the
parameters. The test tracks of :mod:`stkzoo.tracks` are never used.

The folder contains ``log.jsonl``, one line per generation with all proposals and results, and
``best.json``, the parameters of the mean. To continue exactly from the log, also after a kill, run
the same command again.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from stkzoo._arguments import option
from stkzoo._checks import check_name
from stkzoo._locks import locked_folder
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.errors import ConfigError
from stkzoo.tracks import TRAIN_TRACKS

from .common.arguments import QUICK_TRACKS, Natural, RunArguments, ScriptOptions
from .common.command import limit_threads, run_command, training_library
from .common.matches import Match, plan_match_driver, play_matches
from .common.run_folder import LOG, continue_json_lines, keep_arguments, write_json

#: The tuned parameters and their bounds.
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

#: Number of the first starting point; training and evaluation use other numbers.
_FIRST_NUMBER = 5000
_BEST = "best.json"


def from_unit(point: Sequence[float], *, learned_motion: bool = False) -> DriverParameters:
    """Returns the parameters for a point of the unit cube; clips the point to the cube.

    Args:
        point: the tuned parameters.
        learned_motion: the parameter of this name, which is not tuned.
    """
    values: dict[str, Any] = {
        name: low + min(max(float(share), 0.0), 1.0) * (high - low)
        for (name, (low, high)), share in zip(BOUNDS.items(), point, strict=True)
    }
    return DriverParameters(**values, learned_motion=learned_motion)


def to_unit(parameters: DriverParameters) -> list[float]:
    """Returns the point of the unit cube for parameters."""
    return [
        (getattr(parameters, name) - low) / (high - low) for name, (low, high) in BOUNDS.items()
    ]


def drive_all(
    sets: Sequence[DriverParameters], bots: int, places: Sequence[tuple[str, bool, int]]
) -> list[float]:
    """Returns the loss of each set: the mean logarithm of its times over the AI's median times.

    Args:
        sets: the parameter sets.
        bots: karts of the game's AI in each race.
        places: track, direction (whether reverse) and starting point of each race.
    """
    plans = RacingPolicy.of_plans_alone()
    drivers = {str(number): plan_match_driver(plans, each) for number, each in enumerate(sets)}
    matches = [Match((name,), *place, bots) for name in drivers for place in places]
    finishes = play_matches(matches, drivers, side_by_side=len(places))
    logs = [math.log(finish.counted_ratio) for (finish,) in finishes]
    return [float(np.mean(of_set)) for of_set in np.split(np.array(logs), len(sets))]


@dataclass(frozen=True, slots=True)
class TuningArguments(RunArguments):
    """Arguments of a search.

    Attributes:
        generations: total generations.
        population: sets per generation.
        bots: karts of the game's AI.
        sigma: initial step size, as a fraction of the ranges.
        learned_motion: whether plans are simulated with the network of learn_motion.
        tracks: training tracks, or train_only.
    """

    seed: Annotated[int, Meta(ge=0, le=2**32 - 2)] = 0  # that of CMA-ES is larger by one
    generations: int = 40
    population: Annotated[int, Meta(ge=2)] = 14  # CMA-ES compares sets
    bots: Natural = 0
    sigma: float = 0.07
    learned_motion: bool = False
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")

    def __post_init__(self) -> None:
        RunArguments.__post_init__(self)
        for track in self.tracks:
            check_name("training track", track, TRAIN_TRACKS)


#: One number per tuned parameter.
_Point = Annotated[list[float], Meta(min_length=len(BOUNDS), max_length=len(BOUNDS))]


@dataclass(frozen=True, slots=True)
class Generation:
    """A line of the log: the proposals of a generation, and their losses."""

    asked: list[_Point]
    told: list[float]


def tune(options: ScriptOptions, arguments: TuningArguments) -> None:
    """Starts or continues a search.

    Raises:
        ConfigError: a library is missing, or another program uses the folder.
    """
    cma = training_library("cma")
    limit_threads()
    with locked_folder(options.output, "search"):
        _search(options.output, arguments, cma)


def _search(folder: Path, arguments: TuningArguments, cma: Any) -> None:
    keep_arguments(folder, arguments, free=("generations",))
    read = partial(from_unit, learned_motion=arguments.learned_motion)
    present = to_unit(DriverParameters())
    settings = {"popsize": arguments.population, "seed": arguments.seed + 1}
    strategy = cma.CMAEvolutionStrategy(
        present, arguments.sigma, {"bounds": [0.0, 1.0], "verbose": -9, **settings}
    )
    log = continue_json_lines(folder / LOG, Generation)
    for past in log:
        if {len(past.asked), len(past.told)} != {len(strategy.ask())}:
            raise ConfigError(f"{folder / LOG} has another population; give another --output")
        strategy.tell(past.asked, past.told)
    if log:  # a kill can come between the log and this file
        _write_best(folder, strategy, read)
    for generation in range(len(log), arguments.generations):
        begin = time.perf_counter()
        number = _FIRST_NUMBER + 1000 * arguments.seed + generation
        places = list(itertools.product(arguments.tracks, (False, True), [number]))
        asked = [list(map(float, point)) for point in strategy.ask()]
        points = [*asked, present]  # the last one is the reference
        *told, default = drive_all(list(map(read, points)), arguments.bots, places)
        strategy.tell(asked, told)
        line = {"generation": generation, "asked": asked, "told": told}
        with (folder / LOG).open("a") as file:
            file.write(json.dumps({**line, "default": default, "number": number}) + "\n")
        _write_best(folder, strategy, read)
        print(
            f"generation {generation}: time ratio {math.exp(np.mean(told)):.4f} on average, "
            f"{math.exp(min(told)):.4f} at best, {math.exp(default):.4f} with the current "
            f"parameters; {time.perf_counter() - begin:.0f} s",
            flush=True,
        )


def _write_best(
    folder: Path, strategy: Any, read: Callable[[list[float]], DriverParameters]
) -> None:
    mean = read(list(map(float, strategy.result.xfavorite)))
    write_json(folder / _BEST, asdict(mean))


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds, remedy = (ScriptOptions, TuningArguments), "the same command continues"
    return run_command("tune_plans", __doc__, tune, kinds, words, remedy)


if __name__ == "__main__":
    sys.exit(main())
