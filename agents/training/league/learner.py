"""A learner of a league: PPO in races in which frozen rivals drive some of the karts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import PolicyInput
from stkzoo.agents.pretrained.policy import RacingPolicy

from ..common.actors import ActorPool, SharedArray
from ..common.fleet import Finish, FleetStep
from ..common.learner import RolloutResult, Weights
from ..common.starts import Lineup
from ..ppo.network import ActorCritic
from ..ppo.rollouts import ActorArguments, RaceActor
from ..ppo.selfplay import PPOLearner, SelfPlayArguments
from .players import START, PlayerMatchmaker, has_duels


class _RivalRace:
    """Drivers and state of one race."""

    def __init__(self, lineup: Lineup, slots: IntArray) -> None:
        self.lineup, self.slots = lineup, slots
        self.rival: str | None = None
        self.is_rival = np.zeros(len(slots), bool)
        self.ranks = np.zeros(len(slots), int)  # 0 while racing

    def assign(self, rival: str | None, random: np.random.Generator) -> None:
        """Assigns half of the karts to a rival for the current race."""
        self.rival = rival
        self.ranks[:] = 0
        order = random.permutation(len(self.slots))
        self.is_rival = order < len(self.slots) // 2 if rival else np.zeros(len(self.slots), bool)

    @property
    def beaten(self) -> float:
        """Fraction of the duels with the rival that the learner won."""
        own, rivals = self.ranks[~self.is_rival], self.ranks[self.is_rival]
        return float((own[:, None] < rivals).mean())


class LeagueActor(RaceActor):
    """Drives races of a league. In some of them, a rival drives half of the karts.

    Args:
        arguments: see :class:`~stkzoo.agents.training.ppo.rollouts.RaceActor`.
        memory: see :class:`~stkzoo.agents.training.ppo.rollouts.RaceActor`.
        matchmaker: draws the rivals.
        seed: seed of the matchmaking from now on.
    """

    def __init__(
        self,
        arguments: ActorArguments,
        memory: SharedArray,
        matchmaker: PlayerMatchmaker,
        seed: Sequence[int],
    ) -> None:
        super().__init__(arguments, memory)
        self._matchmaker, self._matchmaking = matchmaker, np.random.default_rng(seed)
        self._duels: list[tuple[str, float]] = []

    def begin(self, seed: Sequence[int]) -> None:
        """Starts new races and draws their rivals."""
        super().begin(seed)
        self._races = [_RivalRace(race.lineup, race.slots) for race in self._fleet.races]
        for race in self._races:
            self._assign(race)

    def drive(self, number: int, policy: Weights, critic: Weights) -> RolloutResult:
        """See :meth:`~stkzoo.agents.training.ppo.rollouts.RaceActor.drive`."""
        driven = super().drive(number, policy, critic)
        duels, self._duels = self._duels, []
        return replace(driven, duels=duels)

    def _assign(self, race: _RivalRace) -> None:
        rival = self._matchmaker.draw(self._matchmaking) if has_duels(race.lineup) else None
        race.assign(rival, self._matchmaking)

    def _choose(self, view: PolicyInput, actor: RacingPolicy) -> tuple[IntArray, FloatArray]:
        choices, log_probability = super()._choose(view, actor)
        for race in self._races:
            if race.rival is not None:
                rows = race.slots[race.is_rival]
                policy = self._matchmaker.policy(race.rival)
                own = rows_of(view, rows)
                choices[rows], _ = policy.sample(own, self._matchmaking, self._columns)
        return choices, log_probability

    def _own_outcome(self, outcome: FleetStep) -> FleetStep:
        is_own = np.concatenate([~race.is_rival for race in self._races])
        ends = dict(zip(np.flatnonzero(outcome.ended).tolist(), outcome.finishes, strict=True))
        for race in self._races:
            self._update_race(race, ends)
        return replace(
            outcome,
            rewards=np.where(is_own, outcome.rewards, 0).astype(np.float32),
            active=outcome.active & is_own,
            finishes=[finish for slot, finish in ends.items() if is_own[slot]],
        )

    def _update_race(self, race: _RivalRace, ends: dict[int, Finish]) -> None:
        for row, slot in enumerate(race.slots.tolist()):
            if slot in ends:
                race.ranks[row] = ends[slot].rank
        if not race.ranks.all():
            return
        if race.rival is not None:
            self._matchmaker.update(race.rival, race.beaten)
            self._duels.append((race.rival, race.beaten))
        self._assign(race)


class LeagueLearner(PPOLearner):
    """A run of :mod:`~stkzoo.agents.training.ppo.selfplay` with rivals in some races.

    A rival drives half of the karts in such a race; the learner does not train on those. Each actor
    draws the rivals by the results of the duels before it started, and of its own duels.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
        matchmaker: chooses the rivals, and receives the results of all duels.
        seed: seed of the matchmaking from now on.

    Raises:
        ConfigError: see :class:`~stkzoo.agents.training.ppo.selfplay.PPOLearner`.
    """

    def __init__(
        self,
        folder: Path,
        arguments: SelfPlayArguments,
        matchmaker: PlayerMatchmaker,
        seed: Sequence[int],
    ) -> None:
        self._matchmaker, self._seed = matchmaker, tuple(seed)
        super().__init__(folder, arguments)

    def _first_network(self) -> ActorCritic:
        network = self._new_network()
        if self.arguments.init:  # the file may be gone; the league has a copy
            network.start_from(dict(self._matchmaker.policy(START).weights))
        return network

    def _new_actors(self, arguments: Sequence[tuple[ActorArguments, SharedArray]]) -> ActorPool:
        seeds = [(*self._seed, number) for number in range(len(arguments))]
        own = [
            (*given, self._matchmaker, seed) for given, seed in zip(arguments, seeds, strict=True)
        ]
        return ActorPool(LeagueActor, own)

    def _driven(self) -> list[RolloutResult]:
        driven = super()._driven()
        for rival, beaten in (duel for own in driven for duel in own.duels):
            self._matchmaker.update(rival, beaten)
        return driven


def rows_of(view: PolicyInput, rows: IntArray) -> PolicyInput:
    """Returns the inputs of some of the karts."""
    return PolicyInput(view.inputs[rows], view.prior[rows])
