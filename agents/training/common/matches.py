"""Matches: races between policies of any kind, many in parallel.

A *match driver* drives some karts of a match. It is made from the files of training scripts: a
policy over plans (``ppo``, ``league``), a network without plans (``sb3``, ``imitation``,
``rllib``), or the folder of an agent (:mod:`~stkzoo.agents.training.export`).
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._schema import Count
from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.driver import PlanDriver
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.action_filter import ActionFilter
from stkzoo.agents.pretrained.driver import policy_of, read_numbers, read_policy
from stkzoo.agents.pretrained.ensemble import EnsemblePolicy
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.evaluation import Rating, rate
from stkzoo.wrappers.racing import CHOICES, Surroundings, controls_of_choices, racing_features

from .fleet import Finish, RaceFleet
from .opponents import bot_name
from .run_folder import plan_parameters, run_parameters
from .starts import Lineup, RaceStarts, StartingPoint

#: Name of the plans without learning.
PRIOR = "prior"
#: Name of the game's AI at its highest difficulty in finishing orders.
AI = "ai"
#: Number of members in a match, in addition to one kart of the game's AI.
SEATS = 4
#: Number of matches that one process drives in parallel.
_SIDE_BY_SIDE = 28
#: Number of sets of matches; one set is computed while the games of the others run.
_LANES = 2

#: Drives some karts through one match: returns controls ``(karts, 7)`` for their own state and
#: their surroundings.
KartController = Callable[[Mapping[str, Any], Surroundings], FloatArray]


@dataclass(frozen=True, slots=True)
class MatchDriver:
    """Drives karts through matches.

    Attributes:
        take_karts: returns a controller for a number of karts in the GO phase.
        sees_line: whether the controller needs the racing line in the surroundings.
    """

    take_karts: Callable[[int], KartController]
    sees_line: bool = False


# ---------------------------------------------------------------------- drivers


def plan_match_driver(
    policy: RacingPolicy | EnsemblePolicy, parameters: DriverParameters | None = None
) -> MatchDriver:
    """Returns a driver that takes the most likely choice among plans.

    Args:
        policy: chooses among the plans.
        parameters: parameters of the plans.
    """
    rules = parameters or DriverParameters()

    def take_karts(count: int) -> KartController:
        karts = PlanDriver(count, rules)
        look = karts.view  # at GO, before the first step

        def control(own: Mapping[str, Any], around: Surroundings) -> FloatArray:
            nonlocal look
            view, look = look(own, around), karts.look
            return karts.act(policy.best(view))[0]

        return control

    return MatchDriver(take_karts, rules.racing_line)


def network_driver(choose: Callable[[FloatArray], npt.NDArray[Any]], hold: int = 0) -> MatchDriver:
    """Returns a driver that follows a network's choices on the view ``racing``.

    Args:
        choose: returns choices ``(karts, 5)`` for the karts' inputs, such as
            :meth:`~stkzoo.agents.pretrained.mlp.MlpDriver.best`.
        hold: minimum steps of a drift.
    """

    def take_karts(count: int) -> KartController:
        action_filter = ActionFilter(count, hold)
        look = action_filter.see  # at GO, before the first step

        def control(own: Mapping[str, Any], around: Surroundings) -> FloatArray:
            nonlocal look
            seen, look = look(racing_features(own, around)), action_filter.look
            return controls_of_choices(action_filter.apply(choose(seen)))

        return control

    return MatchDriver(take_karts)


def random_driver(seed: int) -> MatchDriver:
    """Returns a driver with random choices on the view ``racing``."""
    random = np.random.default_rng(seed)
    return network_driver(lambda seen: random.integers(0, CHOICES, (len(seen), len(CHOICES))))


def match_driver(source: str | Path) -> MatchDriver:
    """Returns the driver of a policy.

    Args:
        source: a policy file of a run, the folder of an exported agent, ``"prior"`` (the plans
            without learning) or ``"prior:FILE"`` (with the plan parameters of a JSON file).

    Raises:
        ConfigError: the source is not a policy, or the file has no plan parameters.
    """
    prior, _, file = str(source).partition(":")
    if prior == PRIOR:
        return plan_match_driver(RacingPolicy.of_plans_alone(), plan_parameters(file))
    path = Path(source)
    is_agent = path.is_dir()
    policy = read_policy(path) if is_agent else policy_of(load_weights(path), str(path))
    if isinstance(policy, MlpDriver):
        return network_driver(policy.best, policy.hold)
    rules = read_numbers(path) if is_agent else run_parameters(path)
    return plan_match_driver(policy, rules)


# ---------------------------------------------------------------------- playing


@dataclass(frozen=True, slots=True)
class Match:
    """A match to play.

    Attributes:
        drivers: names of the drivers, one per kart; names may repeat.
        track: name of the track.
        reverse: whether to drive it in reverse.
        number: number of the starting point.
        bots: karts of the game's AI.
        difficulty: difficulty of the game's AI, 0 to 3.
    """

    drivers: tuple[str, ...]
    track: str
    reverse: bool = False
    number: int = 0
    bots: int = 1
    difficulty: int = 3

    @property
    def start(self) -> StartingPoint:
        """Returns the starting point."""
        lineup = Lineup(len(self.drivers), self.bots, self.difficulty)
        return StartingPoint(self.track, self.reverse, self.number, lineup)

    def order(self, finishes: Sequence[Finish], ai: str | None = None) -> list[str]:
        """Returns names in finishing order, each once, at its best rank.

        Args:
            finishes: finishes of the drivers' karts.
            ai: name of the game's AI; ``None`` for names such as ``bot:3``.
        """
        ranks = {finish.rank: name for finish, name in zip(finishes, self.drivers, strict=True)}
        others = ai or bot_name(self.difficulty)
        places = range(1, len(finishes) + self.bots + 1)
        return list(dict.fromkeys(ranks.get(place, others) for place in places))


@dataclass(frozen=True, slots=True)
class MatchRecord:
    """The record of a match in files.

    Attributes:
        turn: the league's turn after which it was played.
        track: name of the track.
        reverse: whether it was driven in reverse.
        order: names in finishing order.
    """

    turn: Count
    track: str
    reverse: bool
    order: list[str]


def _drive(
    matches: Sequence[Match], drivers: Mapping[str, MatchDriver], starts: RaceStarts
) -> Generator[list[list[Finish]] | None]:
    """Drives matches in parallel; yields ``None`` after each step, and finally all finishes."""
    sees_line = any(driver.sees_line for driver in drivers.values())
    fleet = RaceFleet([match.start.lineup for match in matches], starts, sees_line=sees_line)
    names = np.array([name for match in matches for name in match.drivers])
    groups = [(name, np.flatnonzero(names == name)) for name in dict.fromkeys(names.tolist())]
    controllers = [(rows, drivers[name].take_karts(len(rows))) for name, rows in groups]
    finishes: dict[int, Finish] = {}
    try:
        fleet.start_at([(match.track, match.reverse, match.number) for match in matches])
        while fleet.active.any():
            own, around = fleet.surroundings()
            controls = np.zeros((fleet.num_slots, 7), np.float32)
            for rows, control in controllers:
                controls[rows] = control(*_rows_of(own, around, rows))
            fleet.send_controls(controls)
            yield None  # while the games run
            step = fleet.receive_step()
            finishes |= zip(np.flatnonzero(step.ended).tolist(), step.finishes, strict=True)
    finally:
        fleet.close(with_starts=False)
    slots = iter(sorted(finishes))
    yield [[finishes[next(slots)] for _ in match.drivers] for match in matches]


def _rows_of(
    own: Mapping[str, Any], around: Surroundings, rows: npt.NDArray[np.intp]
) -> tuple[dict[str, Any], Surroundings]:
    """Returns own state and surroundings of some of the karts."""
    seen = {part.name: getattr(around, part.name) for part in fields(around)}
    parts = {name: array[rows] for name, array in seen.items() if array is not None}
    return {name: array[rows] for name, array in own.items()}, Surroundings(**parts)


def play_matches(
    matches: Sequence[Match],
    drivers: Mapping[str, MatchDriver],
    side_by_side: int = _SIDE_BY_SIDE,
) -> list[list[Finish]]:
    """Plays matches.

    Args:
        matches: consecutive matches with equal starts share the start of the game.
        drivers: drivers by name.
        side_by_side: number of matches in one batch of observations.

    Returns:
        For each match, the finishes of its drivers' karts.
    """
    cuts = range(0, len(matches), side_by_side)
    waiting = deque(enumerate(matches[first : first + side_by_side] for first in cuts))
    uses = Counter(match.start for match in matches)
    results: dict[int, list[list[Finish]]] = {}
    lanes: dict[int, Generator[list[list[Finish]] | None]] = {}
    starts = RaceStarts()
    try:
        while waiting or lanes:
            while waiting and len(lanes) < _LANES:
                number, part = waiting.popleft()
                lanes[number] = _drive(part, drivers, starts)
            for number, lane in list(lanes.items()):
                if (finishes := next(lane)) is not None:
                    results[number] = finishes
                    del lanes[number]
                    first = number * side_by_side
                    uses -= Counter(m.start for m in matches[first : first + side_by_side])
                    starts.close(keep=uses)
    finally:
        for lane in lanes.values():
            lane.close()
        starts.close()
    return [match for number in sorted(results) for match in results[number]]


def play_records(
    matches: Sequence[Match], drivers: Mapping[str, MatchDriver], turn: int = 0
) -> list[MatchRecord]:
    """Plays matches and returns their records.

    Args:
        matches: matches, each with one kart of the game's AI.
        drivers: drivers by name.
        turn: turn of the league.
    """
    played = zip(matches, play_matches(matches, drivers), strict=True)
    return [MatchRecord(turn, m.track, m.reverse, m.order(ends, AI)) for m, ends in played]


# ---------------------------------------------------------------------- rating


def rate_orders(orders: Sequence[Sequence[str]]) -> dict[str, Rating]:
    """Returns ratings by name from the finishing orders of matches; 25 is the mean.

    Raises:
        ConfigError: the rating library is not installed.
    """
    names = sorted({name for order in orders for name in order})
    numbers = {name: number for number, name in enumerate(names)}
    races = [[numbers[name] for name in order] for order in orders]
    return dict(zip(names, rate(races, len(names)), strict=True))


def payoff(one: str, other: str, records: Sequence[MatchRecord]) -> tuple[float, int]:
    """Returns the fraction of matches in which ``one`` was ahead of ``other``, and their number."""
    duels = [
        r.order.index(one) < r.order.index(other) for r in records if {one, other} <= {*r.order}
    ]
    return (float(np.mean(duels)) if duels else 0.5), len(duels)
