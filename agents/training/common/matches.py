"""Matches between policies: many races at once, in which policies drive some of the karts."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector.utils import create_empty_array

from stkzoo import Phase, race_v0
from stkzoo._schema import Count, Place
from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import PolicyInput
from stkzoo.agents.planning.motion import STEP
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.view import PlanView, around_of, surroundings_view
from stkzoo.agents.pretrained.action_filter import ActionFilter
from stkzoo.agents.pretrained.driver import policy_of, read_numbers, read_policy
from stkzoo.agents.pretrained.ensemble import EnsemblePolicy
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.evaluation import Rating, load_ai_times, rate
from stkzoo.mdp import action_of
from stkzoo.wrappers.racing import controls_of_choices, racing_features

from .run_folder import plan_parameters, run_parameters

#: Name of the plans without learning.
PRIOR = "prior"
#: Name of the game's AI at its highest difficulty in finishing orders.
AI = "ai"
#: Number of members in a match, in addition to one kart of the game's AI.
SEATS = 4
#: Time ratio of a kart that does not finish.
UNFINISHED = 3.0
#: Time limit of a race, as a multiple of the AI's median time.
_PATIENCE = 1.6
#: Number of matches that one process drives in parallel.
SIDE_BY_SIDE = 28

#: Observations of some karts (:class:`~stkzoo.agents.planning.view.PlanSurroundings`), in rows.
Seen = Mapping[str, Any]
#: Drives some karts through matches: returns controls ``(karts, 7)`` for their observations.
KartController = Callable[[Seen], FloatArray]


@functools.cache
def ai_time(track: str, reverse: bool, difficulty: int) -> float:
    """Returns the median time of the game's AI [s]; the difficulty makes all karts faster."""
    return load_ai_times().of(track, reverse, difficulty).median


@dataclass(frozen=True, slots=True)
class MatchDriver:
    """Drives karts through matches.

    Attributes:
        take_karts: returns a controller for a number of karts in the GO phase.
        rules: parameters of the plans among which it chooses; ``None`` without plans.
    """

    take_karts: Callable[[int], KartController]
    rules: DriverParameters | None = None


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
        view = PlanView(count, rules)

        def control(seen: Seen) -> FloatArray:
            return view.drive(policy.best(PolicyInput(**view.observe(seen))))[0]

        return control

    return MatchDriver(take_karts, rules)


def _network_match_driver(policy: MlpDriver) -> MatchDriver:
    """Returns a driver that takes a network's most likely choices on the view ``racing``."""

    def take_karts(count: int) -> KartController:
        action_filter = ActionFilter(count, policy.hold, unit=policy.unit)

        def control(seen: Seen) -> FloatArray:
            inputs = action_filter.look(racing_features(around_of(seen)))
            return controls_of_choices(action_filter.apply(policy.best(inputs)))

        return control

    return MatchDriver(take_karts)


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
        return _network_match_driver(policy)
    rules = read_numbers(path) if is_agent else run_parameters(path)
    return plan_match_driver(policy, rules)


# ---------------------------------------------------------------------- playing


@dataclass(frozen=True, slots=True)
class Finish:
    """The end of a kart's match.

    Attributes:
        ratio: finish time over the AI's median time; ``None`` if the match was cut short.
        rank: final rank, 1 is first.
    """

    ratio: float | None
    rank: Place

    @property
    def counted_ratio(self) -> float:
        """The time ratio; 3 if the match was cut short."""
        return UNFINISHED if self.ratio is None else self.ratio


@dataclass(frozen=True, slots=True)
class Match:
    """A match to play.

    Attributes:
        drivers: names of the drivers, one per kart; names may repeat.
        track: name of the track.
        reverse: whether to drive it in reverse.
        number: number of the start: seed of the grid positions and of the game.
        bots: karts of the game's AI.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
    """

    drivers: tuple[str, ...]
    track: str
    reverse: bool = False
    number: int = 0
    bots: int = 1
    difficulty: int = 3

    @property
    def start(self) -> tuple[Any, ...]:
        """Key of the start, which is equal for matches with equal starts."""
        place = self.track, self.reverse, self.number, self.difficulty
        return len(self.drivers), self.bots, *place

    def order(self, finishes: Sequence[Finish]) -> list[str]:
        """Returns names in finishing order, each once, at its best rank.

        Args:
            finishes: finishes of the drivers' karts.
        """
        ranks = {finish.rank: name for finish, name in zip(finishes, self.drivers, strict=True)}
        places = range(1, len(finishes) + self.bots + 1)
        return list(dict.fromkeys(ranks.get(place, AI) for place in places))


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


class _MatchStarts:
    """Environments of matches, and saved states of their starts in the moment of GO.

    Args:
        sees_line: whether agents observe the racing line.
    """

    def __init__(self, sees_line: bool) -> None:
        self._view = surroundings_view(sees_line)
        self._envs: dict[tuple[int, int, int], Any] = {}
        self._states: dict[tuple[Any, ...], Any] = {}

    def begin(self, match: Match, place: int) -> tuple[Any, dict[str, Any]]:
        """Returns an environment at the start of a match, and its observations.

        Args:
            match: the match.
            place: a number that no match has that is driven at the same time.
        """
        count, bots = len(match.drivers), match.bots
        key = place, count, bots
        if key not in self._envs:
            self._envs[key] = race_v0.parallel_env(
                agents=count, num_kart=count + bots, view=self._view
            )
        env = self._envs[key]
        if match.start not in self._states:
            self._states[match.start] = _state_at_go(env, match)
        seconds = _PATIENCE * ai_time(match.track, match.reverse, match.difficulty)
        options = {"state": self._states[match.start], "max_cycles": math.ceil(seconds / STEP)}
        return env, env.reset(options=options)[0]

    def keep(self, starts: Collection[tuple[Any, ...]]) -> None:
        """Ends the processes of all other starts."""
        for start in self._states.keys() - starts:
            self._states.pop(start).close()

    def close(self) -> None:
        """Ends all processes."""
        self.keep(())
        for env in self._envs.values():
            env.close()


def _state_at_go(env: Any, match: Match) -> Any:
    """Returns the saved state of a match in the moment of GO."""
    place = {"track": match.track, "reverse": match.reverse, "difficulty": match.difficulty}
    observations, _ = env.reset(seed=match.number, options=place)
    waits = action_of(np.eye(1, 7, dtype=np.float32)[0])  # full throttle
    while next(iter(observations.values()))["phase"] < Phase.GO_PHASE:
        observations, *_ = env.step(dict.fromkeys(env.agents, waits))
    return env.save_state()


class _RunningMatch:
    """A match that is being driven.

    Args:
        match: the match.
        first: row of its first kart in the arrays of all karts.
        starts: provides its start.
    """

    def __init__(self, match: Match, first: int, starts: _MatchStarts) -> None:
        self.match, self.finishes = match, dict[int, Finish]()
        self.env, self.observations = starts.begin(match, first)
        self._rows = {agent: first + n for n, agent in enumerate(self.env.possible_agents)}

    def see(self, seen: dict[str, Any]) -> None:
        """Writes the karts' observations into their rows."""
        for agent, observation in self.observations.items():
            for key, value in observation.items():
                seen[key][self._rows[agent]] = value

    def send(self, controls: FloatArray) -> None:
        """Starts a step."""
        actions = {agent: action_of(controls[self._rows[agent]]) for agent in self.env.agents}
        self.env.step_async(actions)

    def receive(self) -> None:
        """Waits for the step and records the karts that ended."""
        self.observations, _, finished, cut, infos = self.env.step_wait()
        match = self.match
        median = ai_time(match.track, match.reverse, match.difficulty)
        for agent, info in infos.items():
            if finished[agent] or cut[agent]:
                ratio = info["finish_time"] / median if finished[agent] else None
                self.finishes[self._rows[agent]] = Finish(ratio, info["position"])


def _drive(
    matches: Sequence[Match], drivers: Mapping[str, MatchDriver], starts: _MatchStarts
) -> list[list[Finish]]:
    """Drives matches in parallel."""
    names = np.array([name for match in matches for name in match.drivers])
    controllers: list[tuple[IntArray, KartController]] = []
    for name in dict.fromkeys(names.tolist()):
        rows = np.flatnonzero(names == name)
        controllers.append((rows, drivers[name].take_karts(len(rows))))
    firsts = np.cumsum([0, *(len(match.drivers) for match in matches)])
    running = [
        _RunningMatch(match, first, starts)
        for match, first in zip(matches, firsts.tolist(), strict=False)
    ]
    space = running[0].env.observation_space("kart_0")
    seen: Any = create_empty_array(space, len(names))
    controls = np.zeros((len(names), 7), np.float32)
    while left := [each for each in running if each.env.agents]:
        for each in left:
            each.see(seen)
        for rows, control in controllers:
            controls[rows] = control({key: array[rows] for key, array in seen.items()})
        for each in left:
            each.send(controls)
        for each in left:
            each.receive()
    return [[each.finishes[row] for row in sorted(each.finishes)] for each in running]


def play_matches(
    matches: Sequence[Match],
    drivers: Mapping[str, MatchDriver],
    side_by_side: int = SIDE_BY_SIDE,
    on_progress: Callable[[int], None] | None = None,
) -> list[list[Finish]]:
    """Plays matches.

    Args:
        matches: consecutive matches with equal starts share the start of the game.
        drivers: drivers by name.
        side_by_side: number of matches in one batch of observations.
        on_progress: called after each batch with the number of matches played.

    Returns:
        For each match, the finishes of its drivers' karts.
    """
    results: list[list[Finish]] = []
    rules = [driver.rules for driver in drivers.values()]
    starts = _MatchStarts(any(each.racing_line for each in rules if each))
    try:
        for first in range(0, len(matches), side_by_side):
            part = matches[first : first + side_by_side]
            starts.keep({match.start for match in part})
            results += _drive(part, drivers, starts)
            if on_progress is not None:
                on_progress(len(results))
    finally:
        starts.close()
    return results


def play_records(
    matches: Sequence[Match], drivers: Mapping[str, MatchDriver], turn: int
) -> list[MatchRecord]:
    """Plays matches and returns their records.

    Args:
        matches: matches, each with one kart of the game's AI.
        drivers: drivers by name.
        turn: turn of the league.
    """
    played = zip(matches, play_matches(matches, drivers), strict=True)
    return [MatchRecord(turn, m.track, m.reverse, m.order(ends)) for m, ends in played]


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
