"""Compares policies in the same races on training tracks; faster than the benchmark.

    python -m stkzoo.agents.training.evaluate prior runs/first/policy-*.safetensors
    python -m stkzoo.agents.training.evaluate prior runs/first runs/second/agent --track train

Each policy drives one race per track, direction and starting point, and always takes its most
likely choice. A policy is one of:

    runs/first/policy-000500000.safetensors   a policy file from any training script
    runs/first                                the newest policy of a run
    agents/swift                              the folder of an exported agent
    prior, prior:tuned/best.json              the plans without learning, with these parameters

The other policies are compared with the first one. ``--output`` keeps the time ratios of a run's
saved policies, and ``plot`` draws them over kart-steps:

    python -m stkzoo.agents.training.evaluate runs/*/policy-*.safetensors --output evaluations
    python -m stkzoo.agents.training.plot evaluations/* --output curves.png
"""

from __future__ import annotations

import itertools
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from stkzoo._arguments import option, positional
from stkzoo._checks import check_whole
from stkzoo._os import make_folder
from stkzoo.errors import ConfigError
from stkzoo.evaluation import BenchmarkForm

from .common.arguments import track_names
from .common.command import ProgressBar, limit_threads, run_command
from .common.matches import SIDE_BY_SIDE, Finish, Match, MatchDriver, match_driver, play_matches
from .common.run_folder import kart_steps_of, saved_policies, write_log

#: First starting point for evaluation; training numbers its starting points from 0.
_FIRST_NUMBER = 1000


def evaluate(
    drivers: Sequence[MatchDriver],
    tracks: Sequence[str],
    numbers: int,
    *,
    karts: int = 1,
    bots: int = 4,
) -> list[list[list[Finish]]]:
    """Drives the races.

    Args:
        drivers: drivers of the policies.
        tracks: tracks, driven in both directions.
        numbers: races per track and direction.
        karts: karts of the policy in each race.
        bots: karts of the game's AI at its highest difficulty in each race.

    Returns:
        For each driver and race, the finishes of its karts.
    """
    starts = range(_FIRST_NUMBER, _FIRST_NUMBER + numbers)
    places = list(itertools.product(tracks, (False, True), starts))
    results: list[list[list[Finish]]] = [[] for _ in drivers]
    by_name = {str(number): driver for number, driver in enumerate(drivers)}
    with ProgressBar(len(places) * len(drivers), unit="races") as bar:

        def show(played: int) -> None:
            bar.show(sum(map(len, results)) + played, "")

        for first in range(0, len(places), SIDE_BY_SIDE):
            part = places[first : first + SIDE_BY_SIDE]
            matches = [Match((name,) * karts, *place, bots) for name in by_name for place in part]
            finishes = play_matches(matches, by_name, len(part), show)
            for match, ends in zip(matches, finishes, strict=True):
                results[int(match.drivers[0])].append(ends)
    return results


def newest_policy(source: str) -> str:
    """Returns the newest policy file of a run's folder; returns other sources unchanged."""
    latest = Path(source) / "policy.safetensors"  # of a run that keeps no others
    default = latest if latest.is_file() else source
    return str(max(saved_policies(Path(source)), default=default))


def _report(sources: Sequence[str], results: Sequence[Sequence[Sequence[Finish]]]) -> None:
    base = _ratios(results[0])
    for source, races in zip(sources, results, strict=True):
        ratios = _ratios(races)
        more = ratios - base
        error = more.std() / max(len(more) - 1, 1) ** 0.5
        ranks = np.array([[finish.rank for finish in ends] for ends in races])
        unfinished = sum(finish.ratio is None for ends in races for finish in ends)
        print(
            f"{source}: {len(races)} races, time ratio {ratios.mean():.4f} "
            f"({more.mean():+.4f} +- {error:.4f}), won {(ranks == 1).any(axis=1).mean():.0%}, "
            f"rank {ranks.mean():.2f}, unfinished {unfinished}",
            flush=True,
        )


def _keep(folder: Path, sources: Sequence[str], time_ratios: Sequence[float]) -> None:
    """Writes the time ratios of saved policies as a log for each run."""
    logs = defaultdict(list)
    for policy, time_ratio in zip(map(Path, sources), time_ratios, strict=True):
        kart_steps = kart_steps_of(policy)
        if kart_steps is not None:
            line = {"kart_steps": kart_steps, "time_ratio": round(time_ratio, 6)}
            logs[policy.absolute().parent.name].append(line)
    for name, log in logs.items():
        make_folder(folder / name, "evaluation")
        write_log(folder / name, sorted(log, key=lambda line: line["kart_steps"]))


def _ratios(results: Sequence[Sequence[Finish]]) -> npt.NDArray[np.float64]:
    """Returns the mean time ratio of each race's karts."""
    return np.array([np.mean([finish.counted_ratio for finish in ends]) for ends in results])


@dataclass(frozen=True, slots=True)
class EvaluationOptions:
    """Options of the command.

    Attributes:
        policies: policy files, folders, or prior; see above.
        form: karts per race: P for the policy's, A for the game's AI's.
        numbers: races per track and direction.
        tracks: names of tracks or of splits, such as validation.
        output: folder for the time ratios of saved policies.

    Raises:
        ConfigError: numbers is below 1, or the form is invalid.
    """

    policies: tuple[str, ...] = positional()
    form: str = "PAAAA"
    numbers: int = 2
    tracks: tuple[str, ...] = option(("train",), flag="--track", metavar="TRACK")
    output: Path | None = option(None, metavar="FOLDER")

    def __post_init__(self) -> None:
        check_whole("numbers", self.numbers, 1)
        if BenchmarkForm.of(self.form).has_population:
            raise ConfigError(f"form is {self.form!r}, expected P and A only, such as PAAAA")


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    return run_command("evaluate", __doc__, _evaluate, (EvaluationOptions,), words)


def _evaluate(options: EvaluationOptions) -> None:
    form = BenchmarkForm.of(options.form)
    limit_threads()
    sources = [newest_policy(source) for source in options.policies]
    tracks = track_names(options.tracks)
    drivers = [match_driver(source) for source in sources]
    if options.output:
        make_folder(options.output, "evaluation")  # before the races, which take minutes
    results = evaluate(drivers, tracks, options.numbers, karts=form.agents, bots=form.rivals)
    _report(sources, results)
    if options.output:
        _keep(options.output, sources, [float(_ratios(races).mean()) for races in results])


if __name__ == "__main__":
    sys.exit(main())
