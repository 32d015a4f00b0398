"""Finds better numbers for the heuristic driver by an evolution strategy.

    python -m stkzoo.agents.training.tune_heuristic --generations 40 --output tuned

CMA-ES (Hansen, "The CMA Evolution Strategy: A Tutorial", 2016; library ``cma``) asks for sets
of parameters around its present mean, and is told how well each drove: the mean logarithm of
its time over the game AI's median time there. In one generation all sets drive the same races,
drawn anew each time from the training tracks, both ways, alone and against four of the game's
AI from both ends of the grid. The test tracks of :mod:`stkzoo.tracks` are never driven.

The folder has ``log.jsonl``, a line a generation with all that was asked and told, from which
the same command goes on exactly, and ``best.json``, the mean's parameters after each generation.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import multiprocessing
import os
import random
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from stkzoo.agents.heuristic import DriverParameters, DriverState, HeuristicDriver
from stkzoo.cores import usable_cores
from stkzoo.errors import ConfigError
from stkzoo.race import Driver, RaceSettings, run_race
from stkzoo.race.benchmark import load_ai_times
from stkzoo.tracks import TRAIN_TRACKS
from stkzoo.whole_file import whole_file

__all__ = ["BOUNDS", "Trial", "drive", "from_unit", "main", "to_unit"]

#: What is tuned, and between which values.
BOUNDS: dict[str, tuple[float, float]] = {
    "wheel_base": (0.8, 1.2),
    "aim_distance": (1.0, 10.0),
    "aim_time": (0.1, 0.7),
    "margin": (0.0, 2.0),
    "greatest_room": (2.5, 7.0),
    "over_cost": (5.0, 50.0),
    "late_time": (0.0, 0.8),
    "late_cost": (0.0, 10.0),
    "angle_cost": (0.0, 15.0),
    "drift_speed": (11.0, 20.0),
    "boost_worth": (4.0, 24.0),
    "big_boost_worth": (4.0, 36.0),
    "boost_wait_cost": (0.0, 4.0),
    "box_worth": (0.0, 12.0),
    "second_box_worth": (0.0, 6.0),
    "small_nitro_worth": (0.0, 20.0),
    "big_nitro_worth": (0.0, 40.0),
    "banana_cost": (2.0, 30.0),
    "gum_cost": (2.0, 30.0),
    "item_radius": (0.4, 1.6),
    "bad_item_radius": (0.6, 2.2),
    "nitro_wait": (0.6, 4.0),
    "nitro_turn": (0.2, 1.1),
    "danger": (0.1, 8.0),
    "straight_angle": (0.05, 0.8),
    "straight_time": (0.4, 2.0),
    "crash_drop": (3.0, 10.0),
    "caution_time": (0.0, 5.0),
    "caution_room": (0.5, 4.0),
}

#: The driver looks at no more segments than this.
_MAX_PATHS = 96
#: A kart that does not finish counts as having taken so many times the AI's time.
_UNFINISHED = 3.0
#: Game time of one step [s].
_STEP = 0.1
_LOG, _BEST = "log.jsonl", "best.json"


@dataclass(frozen=True, slots=True)
class Trial:
    """One race that a set of parameters drives.

    Attributes:
        track: its name.
        reverse: the other way round.
        seed: of the race.
        rivals: how many of the game's AI drive too.
        place: on the grid, 1 is in front.
        difficulty: of the game's AI.
    """

    track: str
    reverse: bool
    seed: int
    rivals: int
    place: int
    difficulty: int


def from_unit(point: Sequence[float]) -> DriverParameters:
    """The parameters that a point of the unit cube stands for; it is moved into the cube."""
    values: dict[str, Any] = {
        name: low + min(max(share, 0.0), 1.0) * (high - low)
        for (name, (low, high)), share in zip(BOUNDS.items(), point, strict=True)
    }
    return DriverParameters(**values)


def to_unit(parameters: DriverParameters) -> list[float]:
    """The point of the unit cube that stands for parameters."""
    return [
        (getattr(parameters, name) - low) / (high - low) for name, (low, high) in BOUNDS.items()
    ]


def drive(parameters: DriverParameters, trial: Trial) -> float:
    """The logarithm of the time over the AI's median time of one race."""
    actor = HeuristicDriver(parameters)

    def make_actor(*_: Any) -> Any:
        state = DriverState()
        return lambda observation: actor(state, observation)

    time = load_ai_times().of(trial.track, trial.reverse, trial.difficulty).median
    rivals = [place for place in range(1, trial.rivals + 2) if place != trial.place]
    result = run_race(
        [Driver.of_actor("tuned", make_actor), *["ai"] * trial.rivals],
        start_positions=[trial.place, *rivals],
        wait_for=[0],
        settings=RaceSettings(
            track=trial.track,
            reverse=trial.reverse,
            seed=trial.seed,
            difficulty=trial.difficulty,
            max_paths=_MAX_PATHS,
            max_steps=math.ceil(_UNFINISHED * time / _STEP),
            error_handling="raise",
        ),
    )
    own = next(row for row in result.agents if row.agent == "kart_0")
    return math.log(_UNFINISHED if own.finish_time is None else own.finish_time / time)


def draw_trials(
    count: int, difficulty: int, share_alone: float, chance: random.Random
) -> list[Trial]:
    """Races of one generation: no track comes twice before all have come."""
    tracks: list[str] = []
    trials = []
    for _ in range(count):
        if not tracks:
            tracks = chance.sample(TRAIN_TRACKS, len(TRAIN_TRACKS))
        rivals = 0 if chance.random() < share_alone else 4
        trials.append(
            Trial(
                track=tracks.pop(),
                reverse=chance.random() < 0.5,
                seed=chance.randrange(2**31),
                rivals=rivals,
                place=chance.choice((1, rivals + 1)),
                difficulty=difficulty,
            )
        )
    return trials


class _Search:
    """The strategy and its log."""

    def __init__(self, options: argparse.Namespace) -> None:
        cma = _library()
        self.folder = Path(options.output)
        self.folder.mkdir(parents=True, exist_ok=True)
        self.options = options
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

    def run_one(self, pool: ProcessPoolExecutor) -> dict[str, Any]:
        """One generation; its line of the log."""
        options = self.options
        chance = random.Random(f"{options.seed} {self.generation}")
        trials = draw_trials(options.races, options.difficulty, options.alone, chance)
        asked = [list(map(float, point)) for point in self._strategy.ask()]
        points = [*asked, to_unit(DriverParameters())]  # the last one is for comparison
        jobs = [pool.submit(drive, from_unit(point), trial) for point in points for trial in trials]
        values = [job.result() for job in jobs]
        scores = [
            sum(values[first : first + len(trials)]) / len(trials)
            for first in range(0, len(values), len(trials))
        ]
        self._strategy.tell(asked, scores[:-1])
        line = {
            "generation": self.generation,
            "asked": asked,
            "told": scores[:-1],
            "default": scores[-1],
            "trials": [asdict(trial) for trial in trials],
        }
        self.generation += 1
        self._keep(line)
        return line

    def _lines(self) -> list[dict[str, Any]]:
        file = self.folder / _LOG
        return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []

    def _keep(self, line: dict[str, Any]) -> None:
        with (self.folder / _LOG).open("a") as log:
            log.write(json.dumps(line) + "\n")
        mean = from_unit(list(map(float, self._strategy.result.xfavorite)))
        with whole_file(self.folder / _BEST) as part:
            part.write_text(json.dumps(asdict(mean), indent=1) + "\n")


def _library() -> Any:
    try:
        return importlib.import_module("cma")
    except ImportError as error:
        raise ConfigError(
            f"tuning needs the library cma ({error}); pip install 'stkzoo[train]'"
        ) from error


def _end_with(parent: int) -> None:
    """Ends this process when its parent is gone, which the pool alone would not do."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.tune_heuristic",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    words.add_argument("--output", default="tuned", help="folder (default: tuned)")
    words.add_argument("--generations", type=int, default=30, help="(default: 30)")
    words.add_argument("--population", type=int, default=16, help="sets each (default: 16)")
    words.add_argument("--races", type=int, default=15, help="of each set (default: 15)")
    words.add_argument("--alone", type=float, default=0.6, help="share without rivals")
    words.add_argument("--difficulty", type=int, default=3, help="of the AI (default: 3)")
    words.add_argument("--sigma", type=float, default=0.08, help="first step, of the ranges")
    words.add_argument("--seed", type=int, default=0, help="(default: 0)")
    words.add_argument("--jobs", type=int, default=usable_cores(), help="races at a time")
    options = words.parse_args(arguments)
    search = _Search(options)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        options.jobs, mp_context=context, initializer=_end_with, initargs=(os.getpid(),)
    ) as pool:
        for _ in range(options.generations):
            line = search.run_one(pool)
            told = line["told"]
            print(
                f"generation {line['generation']}: time ratio "
                f"{math.exp(sum(told) / len(told)):.4f} on average, {math.exp(min(told)):.4f} at "
                f"best, {math.exp(line['default']):.4f} with the present numbers",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
