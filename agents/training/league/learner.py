"""A learner of a league: PPO in races in which frozen rivals drive some of the karts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stkzoo.agents.planning.arrays import FloatArray, IntArray
from stkzoo.agents.planning.driver import PolicyInput
from stkzoo.agents.pretrained.policy import RacingPolicy

from ..common.fleet import Finish, FleetStep, Lineup
from ..ppo.selfplay import PPOLearner, SelfPlayArguments
from .players import PlayerMatchmaker


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


class LeagueLearner(PPOLearner):
    """A run of :mod:`~stkzoo.agents.training.ppo.selfplay` with rivals in some races.

    A rival drives half of the karts in such a race; the learner does not train on those.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
        matchmaker: chooses the rivals.
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
        self._matchmaker = matchmaker
        self._matchmaking = np.random.default_rng(seed)
        super().__init__(folder, arguments)

    def begin_races(self) -> None:
        """Starts new races and draws their rivals."""
        super().begin_races()
        self._races = [
            [_RivalRace(race.lineup, race.slots) for race in fleet.races] for fleet in self._fleets
        ]
        for races in self._races:
            for race in races:
                self._assign(race)

    def _assign(self, race: _RivalRace) -> None:
        can_meet = race.lineup.learners > 1 and not race.lineup.bots
        rival = self._matchmaker.draw(self._matchmaking) if can_meet else None
        race.assign(rival, self._matchmaking)

    def _choose(
        self, group: int, view: PolicyInput, actor: RacingPolicy
    ) -> tuple[IntArray, FloatArray]:
        choices, log_probability = super()._choose(group, view, actor)
        for race in self._races[group]:
            if race.rival is not None:
                rows = race.slots[race.is_rival]
                policy = self._matchmaker.policy(race.rival)
                choices[rows], _ = policy.sample(rows_of(view, rows), self._matchmaking)
        return choices, log_probability

    def _own_outcome(self, group: int, outcome: FleetStep) -> FleetStep:
        is_own = np.concatenate([~race.is_rival for race in self._races[group]])
        ends = dict(zip(np.flatnonzero(outcome.ended).tolist(), outcome.finishes, strict=True))
        for race in self._races[group]:
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
        self._assign(race)


def rows_of(view: PolicyInput, rows: IntArray) -> PolicyInput:
    """Returns the inputs of some of the karts."""
    return PolicyInput(view.inputs[rows], view.prior[rows])
