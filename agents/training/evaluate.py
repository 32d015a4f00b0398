"""Compares policies of runs in the same races, on training tracks; quicker than the benchmark.

    python -m stkzoo.agents.training.evaluate prior runs/first/policy-*.safetensors

Each policy drives, by its likeliest choices, one race for each track, direction and number, from
the same beginning: one that chooses among plans, by the numbers of its run, a network that answers
at once, of ``sb3_selfplay`` or ``distil``, or an agent that ``export_policy`` made, by its folder.
``prior`` is what runs over plans start from: the plans without anything learned; ``prior:by-hand``
with the numbers of that name. The first one named is what the others are compared with.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stkzoo.agents.planning import DriverParameters, PolicyInput
from stkzoo.agents.pretrained.driver import (
    WEIGHTS,
    Policy,
    check_shapes,
    read_network,
    read_numbers,
    read_policy,
)
from stkzoo.agents.pretrained.mlp import MlpDriver, is_network
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.errors import ConfigError
from stkzoo.evaluation import BenchmarkForm
from stkzoo.tracks import SPLITS, TRAIN_TRACKS

from .common.arguments import keep_to_one_thread
from .common.fleet import Beginning, Finish, Fleet, RaceForm
from .common.network_karts import NetworkKarts, seen_by_networks
from .common.plan_parameters import numbers_of_run, plan_numbers

__all__ = ["Entrant", "Outcome", "evaluate", "main"]

#: What names the policy of the plans alone.
PRIOR = "prior"
#: A kart that does not finish counts as having taken so many times the AI's time.
_UNFINISHED = 3.0
#: Races of learning begin with the numbers from 0 on; these are others.
_FIRST_NUMBER = 1000
#: So many races are driven at a time: what one process sees for all karts costs less a kart.
_SIDE_BY_SIDE = 28


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one race.

    Attributes:
        ratio: mean of the policy's karts' times over the AI's median time.
        rank: their mean place.
        is_won: whether one of them was first.
        unfinished: how many of them did not finish; each counts as three times the AI's time.
    """

    ratio: float
    rank: float
    is_won: bool
    unfinished: int

    @classmethod
    def of(cls, finishes: Sequence[Finish]) -> Outcome:
        """Of the ends of a race's karts."""
        ratios = [_UNFINISHED if f.ratio is None else f.ratio for f in finishes]
        ranks = [f.rank for f in finishes]
        unfinished = sum(f.ratio is None for f in finishes)
        return cls(float(np.mean(ratios)), float(np.mean(ranks)), min(ranks) == 1, unfinished)


@dataclass(frozen=True, slots=True)
class Entrant:
    """Who is evaluated.

    Attributes:
        take_over: at the beginning of races, gives what asks for each step of them by what is seen.
        rules: the numbers that its plans go by.
    """

    take_over: Callable[[Fleet], Callable[[PolicyInput], object]]
    rules: DriverParameters

    @classmethod
    def of(cls, source: str) -> Entrant:
        """The likeliest choices of a policy.

        Args:
            source: a run's file, an agent's folder, ``"prior"`` or ``"prior:NUMBERS"``.

        Raises:
            ConfigError: it is no policy's, or there are no numbers of that name.
        """
        prior, _, name = source.partition(":")
        if prior == PRIOR:
            rules = plan_numbers(name) if name else DriverParameters()
            return cls(_by_plans(RacingPolicy.of_plans_alone()), rules)
        if (folder := Path(source)).is_dir():
            return cls._of_agent(folder)
        weights = load_weights(source)
        if is_network(weights):
            return cls(_by_network(MlpDriver(weights, repr(source))), DriverParameters())
        check_shapes(weights, source)
        return cls(_by_plans(RacingPolicy(weights)), numbers_of_run(folder.parent))

    @classmethod
    def _of_agent(cls, folder: Path) -> Entrant:
        if is_network(load_weights(folder / WEIGHTS)):
            return cls(_by_network(read_network(folder)), DriverParameters())
        return cls(_by_plans(read_policy(folder)), read_numbers(folder))


def _by_plans(policy: Policy) -> Callable[[Fleet], Callable[[PolicyInput], object]]:
    return lambda fleet: lambda view: fleet.send(policy.best(view))


def _by_network(driver: MlpDriver) -> Callable[[Fleet], Callable[[PolicyInput], object]]:
    def take_over(fleet: Fleet) -> Callable[[PolicyInput], object]:
        karts = NetworkKarts(fleet, driver.hold)
        return lambda view: karts.send(view, driver.best(seen_by_networks(view)))

    return take_over


def evaluate(
    entrants: Sequence[Entrant], tracks: Sequence[str], form: RaceForm, numbers: int
) -> list[list[Outcome]]:
    """Drives the races; for each entrant its outcomes, in the same order.

    Args:
        entrants: the policies.
        tracks: driven both ways.
        form: who drives.
        numbers: races of each track and direction.
    """
    places = itertools.product(tracks, (False, True), range(numbers))
    beginnings = [(track, reverse, _FIRST_NUMBER + number) for track, reverse, number in places]
    outcomes: list[list[Outcome]] = [[] for _ in entrants]
    for first in range(0, len(beginnings), _SIDE_BY_SIDE):
        some = beginnings[first : first + _SIDE_BY_SIDE]
        fleet = Fleet([form] * len(some), tracks, 0, goes_on=False)
        try:
            for driven, entrant in zip(outcomes, entrants, strict=True):
                driven += _drive(fleet, some, entrant)
        finally:
            fleet.close()
    return outcomes


def _drive(fleet: Fleet, beginnings: Sequence[Beginning], entrant: Entrant) -> list[Outcome]:
    """One race at each beginning, all side by side."""
    fleet.set_rules(entrant.rules)
    view = fleet.begin_at(beginnings)
    send = entrant.take_over(fleet)
    finishes: list[list[Finish]] = [[] for _ in beginnings]
    learners = fleet.num_slots // len(beginnings)
    while fleet.active.any():
        send(view)
        view, outcome = fleet.receive()
        for slot, finish in zip(np.flatnonzero(outcome.ended), outcome.finishes, strict=True):
            finishes[slot // learners].append(finish)
    return [Outcome.of(ends) for ends in finishes]


def _report(sources: Sequence[str], outcomes: Sequence[Sequence[Outcome]]) -> None:
    base = np.array([outcome.ratio for outcome in outcomes[0]])
    for source, own in zip(sources, outcomes, strict=True):
        ratios = np.array([outcome.ratio for outcome in own])
        more = ratios - base
        error = more.std() / max(len(more) - 1, 1) ** 0.5
        print(
            f"{source}: {len(own)} races, time ratio {ratios.mean():.4f} "
            f"({more.mean():+.4f} +- {error:.4f}), won "
            f"{np.mean([o.is_won for o in own]):.0%}, rank {np.mean([o.rank for o in own]):.2f}, "
            f"unfinished {sum(o.unfinished for o in own)}",
            flush=True,
        )


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.evaluate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "policies", nargs="+", help="files of runs, folders of agents, prior, or prior:by-hand"
    )
    parser.add_argument("--form", default="PAAAA", help="who drives (default: PAAAA)")
    parser.add_argument("--numbers", type=int, default=2, help="races of each kind (default: 2)")
    parser.add_argument("--tracks", nargs="+", default=list(TRAIN_TRACKS), help="or train")
    options = parser.parse_args(words)
    try:
        tracks = [t for name in options.tracks for t in SPLITS.get(name, (name,))]
        form = BenchmarkForm.of(options.form)
        keep_to_one_thread()
        entrants = [Entrant.of(source) for source in options.policies]
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    learned = RaceForm(form.agents, form.rivals)
    _report(options.policies, evaluate(entrants, tracks, learned, options.numbers))
    return 0


if __name__ == "__main__":
    sys.exit(main())
