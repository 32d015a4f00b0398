"""A learner of a league: PPO in races in which frozen rivals drive some of the karts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning import PolicyInput
from stkzoo.agents.pretrained.policy import RacingPolicy

from ..common.fleet import Finish, RaceForm, StepOutcome
from ..ppo.selfplay import Arguments, Learner, race_forms

__all__ = ["LeagueLearner", "Matchmaker", "rows_of"]

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]


class Matchmaker(Protocol):
    """Says whom a player meets, and is told how it went."""

    def draw(self, random: np.random.Generator) -> str | None:
        """The rival's name of a race; ``None`` for oneself."""

    def policy(self, name: str) -> RacingPolicy:
        """A rival's policy."""

    def take_in(self, name: str, beaten: float) -> None:
        """Takes in which share of a race's duels with a rival was won."""


class _Table:
    """Who drives what in a race, and how it goes."""

    def __init__(self, form: RaceForm, slots: IntArray, racing: npt.NDArray[np.bool_]) -> None:
        self.form, self.slots = form, slots
        self.rival: str | None = None
        self.is_rival = np.zeros(len(slots), bool)
        self.racing = racing
        self.ranks = np.zeros(len(slots), int)
        #: A race that was under way when a turn began says nothing about who drives since.
        self.is_whole = False

    def deal(self, rival: str | None, random: np.random.Generator) -> None:
        """Gives half of the karts to a rival; for the present race."""
        self.rival = rival
        order = random.permutation(len(self.slots))
        self.is_rival = order < len(self.slots) // 2 if rival else np.zeros(len(self.slots), bool)

    def begin(self) -> None:
        """The next race begins."""
        self.racing[:] = self.is_whole = True

    @property
    def beaten(self) -> float:
        """The share of the duels with the rival that were won."""
        own, rivals = self.ranks[~self.is_rival], self.ranks[self.is_rival]
        return float((own[:, None] < rivals).mean())


class LeagueLearner(Learner):
    """A run of :mod:`~stkzoo.agents.training.ppo.selfplay` with rivals in some races.

    Half of the karts of a race are the rival's; what they see and do is learned from by nobody.

    Args:
        folder: where it is kept.
        arguments: what it is made of.
        matchmaker: says whom it meets.
        seed: of who meets whom, from now on.

    Raises:
        ConfigError: as for the run.
    """

    def __init__(
        self, folder: Path, arguments: Arguments, matchmaker: Matchmaker, seed: Sequence[int]
    ) -> None:
        super().__init__(folder, arguments)
        self._matchmaker = matchmaker
        self._chance = np.random.default_rng(seed)
        forms = race_forms(arguments.forms)
        self._tables: list[list[_Table]] = []
        for group, fleet in enumerate(self._fleets):
            tables, first, active = [], 0, fleet.active
            for form in forms[group :: arguments.groups]:
                slots = np.arange(first, first + form.learners)
                tables.append(_Table(form, slots, active[slots].copy()))
                first += form.learners
            self._tables.append(tables)
            for table in tables:
                self._deal(table)

    def weights(self) -> dict[str, FloatArray]:
        """The policy's as they are now."""
        return dict(self._network.actor().weights)

    def _deal(self, table: _Table) -> None:
        can_meet = table.form.learners > 1 and not table.form.rivals
        rival = self._matchmaker.draw(self._chance) if can_meet else None
        table.deal(rival, self._chance)

    def _choose(
        self, group: int, view: PolicyInput, actor: RacingPolicy
    ) -> tuple[IntArray, FloatArray]:
        choices, log_probability = super()._choose(group, view, actor)
        for table in self._tables[group]:
            if table.rival is not None:
                rows = table.slots[table.is_rival]
                policy = self._matchmaker.policy(table.rival)
                choices[rows], _ = policy.sample(rows_of(view, rows), self._chance)
        return choices, log_probability

    def _judged(self, group: int, outcome: StepOutcome) -> StepOutcome:
        is_own = np.concatenate([~table.is_rival for table in self._tables[group]])
        ends = dict(zip(np.flatnonzero(outcome.ended).tolist(), outcome.finishes, strict=True))
        for table in self._tables[group]:
            self._take_in(table, ends)
        return replace(
            outcome,
            rewards=np.where(is_own, outcome.rewards, 0).astype(np.float32),
            active=outcome.active & is_own,
            finishes=[finish for slot, finish in ends.items() if is_own[slot]],
        )

    def _take_in(self, table: _Table, ends: dict[int, Finish]) -> None:
        for row, slot in enumerate(table.slots.tolist()):
            if slot in ends:
                table.ranks[row], table.racing[row] = ends[slot].rank, False
        if table.racing.any():
            return
        if table.rival is not None and table.is_whole:
            self._matchmaker.take_in(table.rival, table.beaten)
        table.begin()
        self._deal(table)


def rows_of(view: PolicyInput, rows: IntArray) -> PolicyInput:
    """What some of the karts see."""
    return PolicyInput(view.inputs[rows], view.prior[rows])
