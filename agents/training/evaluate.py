"""Evaluates policies in the same races, on training tracks; quicker than the benchmark.

    python -m stkzoo.agents.training.evaluate prior runs/first/policy-*.safetensors
    python -m stkzoo.agents.training.evaluate prior runs/first runs/second/agent --tracks train

Each policy drives one race per track, direction and number, by its most likely choices. A policy is

    runs/first/policy-000500000.safetensors   a policy file of a run of any script
    runs/first                                the newest policy of a run
    agents/swift                              the folder of an exported agent
    prior, prior:tuned/best.json              the plans with nothing learned, by these parameters

The first one is what the others are compared with.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stkzoo.evaluation import BenchmarkForm
from stkzoo.tracks import TRAIN_TRACKS

from .common.arguments import track_names
from .common.command import command_parser, limit_threads, run_command
from .common.fleet import Finish
from .common.matches import Match, MatchDriver, match_driver, play_matches

#: The time ratio of a kart that does not finish.
_UNFINISHED = 3.0
#: Races of learning have starting points from 0 on; these are others.
_FIRST_NUMBER = 1000
#: Starting points that all policies drive before the next ones are started.
_SIDE_BY_SIDE = 28


@dataclass(frozen=True, slots=True)
class PolicyResult:
    """The result of a policy's karts in one race.

    Attributes:
        ratio: their mean time over the AI's median time.
        rank: their mean place.
        is_won: whether one of them was first.
        unfinished: how many did not finish; each counts as three times the AI's time.
    """

    ratio: float
    rank: float
    is_won: bool
    unfinished: int

    @classmethod
    def of(cls, finishes: Sequence[Finish]) -> PolicyResult:
        """The result of these finishes."""
        ratios = [_UNFINISHED if f.ratio is None else f.ratio for f in finishes]
        ranks = [f.rank for f in finishes]
        unfinished = sum(f.ratio is None for f in finishes)
        return cls(float(np.mean(ratios)), float(np.mean(ranks)), min(ranks) == 1, unfinished)


def evaluate(
    drivers: Sequence[MatchDriver],
    tracks: Sequence[str],
    numbers: int,
    *,
    karts: int = 1,
    bots: int = 4,
    first_number: int = _FIRST_NUMBER,
) -> list[list[PolicyResult]]:
    """Drives the races; for each driver its results, in the same order.

    Args:
        drivers: of the policies.
        tracks: driven in both directions.
        numbers: races per track and direction.
        karts: karts of the policy in a race.
        bots: karts of the game's AI at its hardest.
        first_number: number of the first starting point.
    """
    starts = range(first_number, first_number + numbers)
    places = list(itertools.product(tracks, (False, True), starts))
    results: list[list[PolicyResult]] = [[] for _ in drivers]
    by_name = {str(number): driver for number, driver in enumerate(drivers)}
    for first in range(0, len(places), _SIDE_BY_SIDE):
        part = places[first : first + _SIDE_BY_SIDE]
        matches = [Match((name,) * karts, *place, bots) for name in by_name for place in part]
        finishes = play_matches(matches, by_name, side_by_side=len(part))
        for match, ends in zip(matches, finishes, strict=True):
            results[int(match.drivers[0])].append(PolicyResult.of(ends))
    return results


def newest_policy(source: str) -> str:
    """The newest policy file of a run's folder; anything else is returned as it is."""
    return str(max(Path(source).glob("policy-*.safetensors"), default=source))


def _report(sources: Sequence[str], results: Sequence[Sequence[PolicyResult]]) -> None:
    base = np.array([result.ratio for result in results[0]])
    for source, own in zip(sources, results, strict=True):
        ratios = np.array([result.ratio for result in own])
        more = ratios - base
        error = more.std() / max(len(more) - 1, 1) ** 0.5
        print(
            f"{source}: {len(own)} races, time ratio {ratios.mean():.4f} "
            f"({more.mean():+.4f} +- {error:.4f}), won "
            f"{np.mean([r.is_won for r in own]):.0%}, rank {np.mean([r.rank for r in own]):.2f}, "
            f"unfinished {sum(r.unfinished for r in own)}",
            flush=True,
        )


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = command_parser("evaluate", __doc__)
    parser.add_argument("policies", nargs="+", help="policy files, folders, or prior; see above")
    parser.add_argument(
        "--form", default="PAAAA", help="karts: P the policy's, A the game's AI's (PAAAA)"
    )
    parser.add_argument("--numbers", type=int, default=2, help="races per track and direction (2)")
    parser.add_argument(
        "--tracks", nargs="+", default=list(TRAIN_TRACKS), help="tracks, or train (train)"
    )
    options = parser.parse_args(words)
    return run_command(lambda: _evaluate(options))


def _evaluate(options: argparse.Namespace) -> None:
    form = BenchmarkForm.of(options.form)
    limit_threads()
    sources = [newest_policy(source) for source in options.policies]
    drivers = [match_driver(source) for source in sources]
    tracks = track_names(options.tracks)
    results = evaluate(drivers, tracks, options.numbers, karts=form.agents, bots=form.rivals)
    _report(sources, results)


if __name__ == "__main__":
    sys.exit(main())
