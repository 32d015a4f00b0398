"""Judges a kept policy of ``sb3_selfplay`` in races of its own, beside the training.

    python -m stkzoo.agents.training.sb3.evaluation runs/first policy-000200000

It drives by its likeliest choices from the grid, against where it started, one of its past selves,
random choices and one of the game's bots, easy and hard in turn. What came of it is a file in the
run's folder ``evaluations``; the ratings are of all orders in these files together.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo._os import atomic_write
from stkzoo.agents.pretrained.mlp import KartPolicy, load_driver
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.ratings import Rating, rate
from stkzoo.wrappers.racing import CHOICES

from .matches import Heat, drive

__all__ = [
    "RATINGS",
    "BackgroundJudge",
    "Judgement",
    "judge",
    "main",
    "ratings_of",
    "read_judgements",
    "write_ratings",
]

#: What the first kept policy of a run and one that draws its choices by chance are called.
START, RANDOM = "start", "random"
#: Where the judgements of a run are, and the ratings of all of them.
FOLDER, RATINGS = "evaluations", "ratings.json"


@dataclass(frozen=True, slots=True)
class Judgement:
    """What came of a policy's races.

    Attributes:
        name: the policy's; that of the run's first is ``start``.
        kart_steps: how many it had learned from.
        orders: who came in first, second, ... in each race.
        ratios: by name, in each race: its time over the median time of the game's AI in such a
            race; who did not finish counts as if going on at its pace.
    """

    name: str
    kart_steps: int
    orders: list[list[str]]
    ratios: dict[str, list[float]]

    def ratio(self, name: str | None = None) -> float:
        """The mean time ratio of the policy, or of a rival."""
        return float(np.mean(self.ratios[self.name if name is None else name]))


def kart_steps_of(name: str) -> int:
    """How many kart-steps a kept policy's name tells of."""
    return int(name.removeprefix("policy-"))


def judge(run: Path, name: str, tracks: Sequence[str], races: int) -> Judgement:
    """Drives a policy's races and writes what came of them.

    Args:
        run: the run's folder.
        name: of one of its kept policies.
        tracks: driven in turn.
        races: how many.

    Raises:
        ConfigError: there is no such policy.
    """
    older = sorted(path.stem for path in run.glob("policy-*.safetensors") if path.stem < name)
    own = name if older else START
    drivers: dict[str, Callable[[], KartPolicy]] = {own: _likeliest(run, name)}
    if older:
        drivers[START] = _likeliest(run, older[0])
    if len(older) > 1:
        past = older[len(older) // 2]
        drivers[past] = _likeliest(run, past)
    by_chance = _random_choices(kart_steps_of(name))
    drivers[RANDOM] = lambda: by_chance
    orders: list[list[str]] = []
    ratios: dict[str, list[float]] = {driver: [] for driver in drivers}
    parent = os.getppid()
    for number in range(races):
        if os.getppid() != parent:
            raise ConfigError("the training that asked for this is gone")
        track = tracks[number % len(tracks)]
        heat = Heat(tuple(drivers), track, 1000 + number, difficulty=number % 4)
        (end,) = drive([heat], drivers)
        orders.append(end.order)
        for driver, ratio in end.ratios.items():
            ratios[driver].append(round(ratio, 4))
    judgement = Judgement(own, kart_steps_of(name), orders, ratios)
    (run / FOLDER).mkdir(exist_ok=True)
    with atomic_write(run / FOLDER / f"{name}.json") as part:
        part.write_text(json.dumps(asdict(judgement), indent=1) + "\n")
    return judgement


def _likeliest(run: Path, name: str) -> Callable[[], KartPolicy]:
    return load_driver(run / f"{name}.safetensors").new_race


def _random_choices(seed: int) -> KartPolicy:
    random = np.random.default_rng(seed)

    def choose(observations: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        return random.integers(0, CHOICES, (len(observations), len(CHOICES)))

    return choose


def read_judgements(run: Path) -> list[Judgement]:
    """All of a run, by their kart-steps."""
    files = sorted((run / FOLDER).glob("policy-*.json"))
    return [Judgement(**json.loads(file.read_text())) for file in files]


def ratings_of(judgements: Sequence[Judgement]) -> dict[str, Rating]:
    """Everybody's rating, of the orders in all races; 25 is the mean.

    Raises:
        ConfigError: the library of the ratings is not installed.
    """
    orders = [order for judgement in judgements for order in judgement.orders]
    names = sorted({name for order in orders for name in order})
    numbers = {name: number for number, name in enumerate(names)}
    races = [[numbers[name] for name in order] for order in orders]
    return dict(zip(names, rate(races, len(names)), strict=True))


def write_ratings(run: Path) -> list[str]:
    """Writes ``ratings.json`` of all judgements of a run.

    Returns:
        A table for people, line by line.
    """
    judgements = read_judgements(run)
    ratings = ratings_of(judgements)
    policies = [
        {
            "name": judgement.name,
            "kart_steps": judgement.kart_steps,
            "time_ratio": judgement.ratio(),
            "rating": ratings[judgement.name].value,
            "rating_low": ratings[judgement.name].low,
            "rating_high": ratings[judgement.name].high,
        }
        for judgement in judgements
    ]
    known = {judgement.name for judgement in judgements}
    others = {name: asdict(rating) for name, rating in ratings.items() if name not in known}
    table = _table(judgements, ratings)
    with atomic_write(run / RATINGS) as part:
        found = {"policies": policies, "others": others, "table": table}
        part.write_text(json.dumps(found, indent=1) + "\n")
    return table


def _table(judgements: Sequence[Judgement], ratings: dict[str, Rating]) -> list[str]:
    lines = [f"{'':>18}  rating (95 % interval)  time ratio"]
    for name in sorted(ratings, key=lambda name: -ratings[name].value):
        rating = ratings[name]
        found = [ratio for judgement in judgements for ratio in judgement.ratios.get(name, [])]
        ratio = f"{np.mean(found):10.2f}" if found else f"{'':>10}"
        interval = f"({rating.low:5.1f} to {rating.high:5.1f})"
        lines.append(f"{name:>18}  {rating.value:5.1f} {interval}  {ratio}")
    return lines


class BackgroundJudge:
    """Judges kept policies one after another, in a process beside this one.

    Args:
        run: the run's folder.
        tracks: what they drive on.
        races: how many races each.
    """

    def __init__(self, run: Path, tracks: Sequence[str], races: int) -> None:
        self._run, self._tracks, self._races = run, tuple(tracks), races
        self._waiting: deque[str] = deque()
        self._process: subprocess.Popen[bytes] | None = None
        self.failures = 0

    def ask(self, name: str) -> None:
        """Puts a policy in the queue, unless it has been judged."""
        if not (self._run / FOLDER / f"{name}.json").exists() and name not in self._waiting:
            self._waiting.append(name)

    def poll(self) -> bool:
        """Goes on with the queue; whether a judgement has come in since the last call."""
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return False
            self._process = None
            self.failures += code != 0
            if self._waiting:
                self._start(self._waiting.popleft())
            return code == 0
        if self._waiting:
            self._start(self._waiting.popleft())
        return False

    def finish(self, seconds: float) -> bool:
        """Waits until the one that is being judged is done; see :meth:`poll`.

        Args:
            seconds: no longer than this.
        """
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(seconds)
        return self.poll()

    @property
    def is_busy(self) -> bool:
        """Whether something is judged or waits for it."""
        return self._process is not None or bool(self._waiting)

    def close(self) -> None:
        """Ends it."""
        self._waiting.clear()
        if self._process is not None:
            self._process.terminate()
            self._process.wait()
            self._process = None

    def _start(self, name: str) -> None:
        words = ["-m", __name__, str(self._run), name, "--races", str(self._races)]
        self._process = subprocess.Popen(  # noqa: S603 - this program
            [sys.executable, *words, "--tracks", *self._tracks],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.sb3.evaluation",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("run", type=Path, help="the run's folder")
    parser.add_argument("policy", help="a kept policy's name, such as policy-000200000")
    parser.add_argument("--tracks", nargs="+", default=["lighthouse"], help="(lighthouse)")
    parser.add_argument("--races", type=int, default=6, help="(6)")
    options = parser.parse_args(words)
    if hasattr(os, "nice"):
        os.nice(5)  # what learns goes first
    try:
        judge(options.run, options.policy, options.tracks, options.races)
        table = write_ratings(options.run)
    except StkzooError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print("\n".join(table))
    return 0


if __name__ == "__main__":
    sys.exit(main())
