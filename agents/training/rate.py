"""Rates the kept policies of runs against one another: does self-play get better and better?

    python -m stkzoo.agents.training.rate runs/first runs/second --output ratings

The runs are of ``ppo_selfplay`` or of ``sb3_selfplay``. Races of four policies and one kart of the
game's AI at its hardest, on training tracks; who meets whom and where is drawn evenly. Each race
is a line of ``matches.jsonl``: the same command with a higher ``--matches`` goes on, and so does it
after a kill. From all orders together come ratings with intervals (``ratings.json``) and the
picture of them over kart-steps (``ratings.png``); and of any two that met, how often the one with
more kart-steps was ahead. ``start`` is what runs start from: the plans alone, or the first run's
policy that has learned nothing.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from stkzoo._os import atomic_write
from stkzoo.agents.planning import DriverParameters
from stkzoo.agents.pretrained.mlp import KartPolicy, MlpDriver, load_driver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.errors import ConfigError
from stkzoo.evaluation.plotting import new_figure, save_figure
from stkzoo.evaluation.ratings import Rating
from stkzoo.evaluation.statistics import percentile_interval
from stkzoo.tracks import TRAIN_TRACKS

from .common.arguments import changes, keep_to_one_thread
from .common.plan_parameters import numbers_of_run
from .league.matches import AI, SEATS, Match, Pairing, play, ratings_of
from .sb3.matches import Heat, bots_of, drive

__all__ = ["START", "Progress", "draw_pairing", "kept_policies", "main", "progress_of"]

#: What all runs start from.
START = "start"
_MATCHES, _RATINGS, _PICTURE = "matches.jsonl", "ratings.json", "ratings.png"
_KEPT = "policy-*.safetensors"
#: So many are raced before they are written down.
_AT_ONCE = 16
#: Sets of races drawn for an interval.
_DRAWS = 2000
#: Plays matches.
Player = Callable[[Sequence[Pairing]], list[Match]]
_TRACKS = tuple(track for track in TRAIN_TRACKS if track != "black_forest")


@dataclass(frozen=True, slots=True)
class Progress:
    """How much there is in having learned for longer.

    Attributes:
        duels: pairs of policies with unlike kart-steps, of all races.
        ahead: the share of these in which the one with more kart-steps came in before the other.
        low: lower end of its interval: a bootstrap over races.
        high: upper end.
    """

    duels: int
    ahead: float
    low: float
    high: float


def progress_of(matches: Sequence[Match]) -> Progress:
    """What matches of kept policies tell about learning."""
    counts = np.array([_duels(match.order) for match in matches])
    rows = np.random.default_rng(0).integers(len(counts), size=(_DRAWS, len(counts)))
    ahead, duels = counts[rows].sum(axis=1).T
    low, high = percentile_interval(ahead / duels)
    won, total = counts.sum(axis=0)
    return Progress(int(total), float(won / total), float(low), float(high))


def _duels(order: Sequence[str]) -> tuple[int, int]:
    """Of two policies in a race, how often the one that learned for longer is ahead; how many."""
    steps = [_millions(name) for name in order if name != AI]
    unlike = [(first, second) for first, second in combinations(steps, 2) if first != second]
    return sum(first > second for first, second in unlike), len(unlike)


def _millions(name: str) -> float:
    """A policy's kart-steps, of its name."""
    return 0.0 if name == START else float(name.rpartition(" ")[2])


def kept_policies(runs: Sequence[Path], every: int) -> dict[str, Path]:
    """The policies that runs have kept, by name: the run's, and millions of kart-steps.

    Args:
        runs: their folders.
        every: leave out those that come sooner after the one before [kart-steps].

    Raises:
        ConfigError: a folder has none, or two runs have the same name.
    """
    found: dict[str, Path] = {}
    for run in runs:
        files = sorted(run.glob(_KEPT))
        if not files:
            raise ConfigError(f"{str(run)!r} has no {_KEPT}; is it a run's folder?")
        last = 0
        for file in files:
            steps = _steps_of(file.name)
            if steps - last < every and file != files[-1]:
                continue
            name, last = f"{run.name} {steps / 1e6:.2f}", steps
            if name in found:
                raise ConfigError(f"two policies are called {name!r}; give the runs other names")
            found[name] = file
    return found


def players_of(runs: Sequence[Path], files: Mapping[str, Path]) -> tuple[list[str], Player]:
    """Who races, and what plays their matches.

    Args:
        runs: the runs' folders, all of one script.
        files: their kept policies by name.

    Raises:
        ConfigError: the runs are of both scripts, or a file is no policy's.
    """
    weights = {name: load_weights(file) for name, file in files.items()}
    kinds = {"action_net.weight" in own for own in weights.values()}
    if len(kinds) > 1:
        raise ConfigError(
            "these are runs of ppo_selfplay and of sb3_selfplay, expected runs of one of them"
        )
    if kinds == {False}:
        rules = common_numbers(runs)
        policies = {START: RacingPolicy.of_plans_alone()}
        policies |= {name: RacingPolicy(own) for name, own in weights.items()}
        return sorted(policies), lambda pairings: play(pairings, policies, 0, rules)
    drivers = {name: MlpDriver(own, str(files[name])).new_race for name, own in weights.items()}
    drivers[START] = load_driver(min(runs[0].glob(_KEPT))).new_race
    return sorted(drivers), lambda pairings: play_heats(pairings, drivers)


def play_heats(
    pairings: Sequence[Pairing], drivers: Mapping[str, Callable[[], KartPolicy]]
) -> list[Match]:
    """Plays matches of drivers on the view ``racing``, the game's AI at the end of the grid."""
    ends = drive([Heat(p.members, p.track, p.number, p.reverse) for p in pairings], drivers)
    ai = bots_of(3)
    return [
        Match(0, p.track, p.reverse, [AI if name == ai else name for name in end.order])
        for p, end in zip(pairings, ends, strict=True)
    ]


def _steps_of(name: str) -> int:
    return int(re.findall(r"\d+", name)[-1])


def draw_pairing(names: Sequence[str], number: int) -> Pairing:
    """The match of a number: the same names and number, the same match.

    Everybody comes equally often: the names are shuffled, dealt out, and shuffled anew.
    """
    seats = [number * SEATS + seat for seat in range(SEATS)]
    rounds = {seat // len(names) for seat in seats}
    order = {turn: np.random.default_rng([turn, len(names)]).permutation(names) for turn in rounds}
    chosen = [str(order[seat // len(names)][seat % len(names)]) for seat in seats]
    places = [(track, reverse) for track in _TRACKS for reverse in (False, True)]
    lap, at = divmod(number, len(places))
    track, reverse = places[int(np.random.default_rng([lap, 1]).permutation(len(places))[at])]
    return Pairing(tuple(chosen), track, reverse, 3000 + lap)


def _read(file: Path) -> list[Match]:
    if not file.exists():
        return []
    return [Match(**json.loads(line)) for line in file.read_text().splitlines()]


def _write(
    ratings: Mapping[str, Rating], progress: Progress, matches: Sequence[Match], folder: Path
) -> None:
    rows = [
        {"name": name, **asdict(rating), "matches": sum(name in m.order for m in matches)}
        for name, rating in sorted(ratings.items())
    ]
    report = {"matches": len(matches), "learned_longer": asdict(progress), "ratings": rows}
    with atomic_write(folder / _RATINGS) as part:
        part.write_text(json.dumps(report, indent=1) + "\n")
    _draw(ratings, len(matches), folder / _PICTURE)


def _draw(ratings: Mapping[str, Rating], count: int, file: Path) -> None:
    figure = new_figure(8, 4.5)
    axis = figure.subplots()
    runs = sorted({name.rsplit(" ", 1)[0] for name in ratings if " " in name})
    for run in runs:
        own = sorted(
            (_millions(name), rating)
            for name, rating in ratings.items()
            if name.startswith(f"{run} ")
        )
        if START in ratings:
            own.insert(0, (0.0, ratings[START]))
        steps = [at for at, _ in own]
        (line,) = axis.plot(steps, [r.value for _, r in own], marker="o", ms=3, label=run)
        lows, highs = [r.low for _, r in own], [r.high for _, r in own]
        axis.fill_between(steps, lows, highs, alpha=0.15, color=line.get_color(), lw=0)
    if AI in ratings:
        ai = ratings[AI]
        axis.axhline(ai.value, color="0.4", ls="--", label="the game's AI at its hardest")
        axis.axhspan(ai.low, ai.high, color="0.4", alpha=0.1, lw=0)
    axis.set_xlabel("million kart-steps")
    axis.set_ylabel("rating (Plackett-Luce; bands: 95 %)")
    axis.set_title(f"Kept policies in {count} races against one another", fontsize=10)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    save_figure(figure, file)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.rate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs, all of one script")
    parser.add_argument("--output", required=True, type=Path, help="folder for races and ratings")
    parser.add_argument(
        "--matches", type=int, default=200, help="races there shall be in all (default: 200)"
    )
    parser.add_argument(
        "--every",
        type=int,
        default=1_000_000,
        help="kart-steps between policies that race (default: 1000000); the last one always does",
    )
    return parser


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = _parser().parse_args(words)
    try:
        keep_to_one_thread()
        files = kept_policies(options.runs, options.every)
        names, player = players_of(options.runs, files)
        _race(names, player, options.output, options.matches)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


def common_numbers(runs: Sequence[Path]) -> DriverParameters:
    """The numbers that the plans of all runs go by.

    Raises:
        ConfigError: they go by different ones.
    """
    numbers = {run: numbers_of_run(run) for run in runs}
    first = runs[0]
    for run, own in numbers.items():
        if told := changes(asdict(numbers[first]), asdict(own)):
            raise ConfigError(
                f"the plans of {str(first)!r} and {str(run)!r} go by different numbers, expected "
                f"the same: {told}; rate these runs apart, or race agents made of them"
            )
    return numbers[first]


def _race(names: Sequence[str], player: Player, folder: Path, wanted: int) -> None:
    if len(names) < SEATS:
        raise ConfigError(f"there are {len(names)} policies, expected {SEATS} or more; see --every")
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / _MATCHES
    matches = _read(file)
    while len(matches) < wanted:
        numbers = range(len(matches), min(wanted, len(matches) + _AT_ONCE))
        played = player([draw_pairing(names, number) for number in numbers])
        with file.open("a") as out:
            out.writelines(json.dumps(asdict(match)) + "\n" for match in played)
        matches += played
        print(f"{len(matches)} of {wanted} races", flush=True)
    ratings, progress = ratings_of(matches), progress_of(matches)
    _write(ratings, progress, matches, folder)
    for name, rating in sorted(ratings.items(), key=lambda item: -item[1].value):
        print(f"{rating.value:6.2f} ({rating.low:.2f}..{rating.high:.2f})  {name}")
    print(
        f"who has learned for longer is ahead in {progress.ahead:.1%} "
        f"({progress.low:.1%}..{progress.high:.1%}) of {progress.duels} duels"
    )


if __name__ == "__main__":
    sys.exit(main())
