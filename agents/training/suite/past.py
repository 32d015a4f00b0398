"""Self-play against past policies: shared parts of fictitious and prioritized self-play.

In half of the races, a past policy drives some of the karts: one of the teams or, without teams,
half of the karts, rounded down. The learner does not train on those.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.pretrained.mlp import MlpDriver, sample_choices
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.errors import ConfigError
from stkzoo.suite import Task, can_learn

from ..common.actors import ActorPool
from ..common.learner import RolloutResult, Weights
from ..common.opponents import Rival, RivalPool
from .actor import TaskActor
from .learner import TaskArguments, TaskFacts, TaskLearner

#: Number of past policies that a run keeps.
_POOL_SIZE = 40
#: Share of the races in which a past policy drives some of the karts.
_SHARE = 0.5


class PastActor(TaskActor):
    """Drives races of a task. In some of them, a past policy drives some of the karts.

    Args:
        *given: see :class:`.actor.TaskActor`.
        folder: folder of the past policies.
        teams: numbers of the agents of each team; empty without teams.
    """

    def __init__(self, *given: Any, folder: Path, teams: Sequence[Sequence[int]]) -> None:
        super().__init__(*given)
        self._folder, self._teams = folder, teams
        self._policies: dict[str, MlpDriver] = {}

    def begin(self, seed: Sequence[int]) -> None:
        """Starts new races."""
        super().begin(seed)
        self._chance = np.random.default_rng([*seed, 1])
        self._rivals: list[str] = [""] * self._races.num_races
        self._positions = np.zeros((self._races.num_races, self._races.num_agents), int)
        self._are_new = True

    def drive(
        self, number: int, policy: Weights, critic: Weights, odds: Mapping[str, float] | None = None
    ) -> RolloutResult:
        """Fills a rollout.

        Args:
            number: number of the rollout, 0 or 1.
            policy: weights of the policy.
            critic: weights of the value network.
            odds: probability of each past policy, by the name of its file.
        """
        self._odds, self._duels = odds or {}, list[tuple[str, float]]()
        if self._are_new:
            for race in range(self._races.num_races):
                self._draw_rival(race)
        self._are_new = False
        return replace(super().drive(number, policy, critic), duels=self._duels)

    def _draw_rival(self, race: int) -> None:
        """Draws the drivers of a race that begins."""
        learners = self._races.num_agents
        own = np.ones(learners, np.bool_)
        self._rivals[race] = ""
        if self._odds and self._chance.random() < _SHARE:
            names, odds = list(self._odds), list(self._odds.values())
            self._rivals[race] = names[int(self._chance.choice(len(names), p=odds))]
            if self._teams:
                own[list(self._teams[int(self._chance.integers(len(self._teams)))])] = False
            else:
                own[self._chance.permutation(learners)[: learners // 2]] = False
        self._is_own[race * learners : (race + 1) * learners] = own

    def _choose(self, logits: FloatArray) -> IntArray:
        choices = super()._choose(logits)
        rivals = np.repeat(np.array(self._rivals), self._races.num_agents)
        for name in sorted({*self._rivals} - {""}):
            rows = np.flatnonzero((rivals == name) & ~self._is_own)
            logits = self._policy(name).logits(self._observations[rows])
            choices[rows] = sample_choices(logits, self._chance)
        return choices

    def _policy(self, name: str) -> MlpDriver:
        if name not in self._policies:
            self._policies[name] = MlpDriver(load_weights(self._folder / name))
        return self._policies[name]

    def _look_at(self, finals: Mapping[int, tuple[Any, dict[str, Any]]]) -> None:
        for slot, (_, info) in finals.items():
            race, agent = divmod(slot, self._races.num_agents)
            self._positions[race, agent] = info["position"]
            if self._positions[race].all():
                self._end_race(race)

    def _end_race(self, race: int) -> None:
        """Records the result of a race against a past policy, and draws the next one."""
        if self._rivals[race]:
            is_own = self._is_own.reshape(self._positions.shape)[race]
            own, others = self._positions[race, is_own], self._positions[race, ~is_own]
            self._duels.append((self._rivals[race], float((own[:, None] < others).mean())))
        self._positions[race] = 0
        self._draw_rival(race)


@dataclass(frozen=True, slots=True)
class PastFacts(TaskFacts):
    """The facts in a checkpoint.

    Attributes:
        pool: the past policies.
    """

    pool: tuple[Rival, ...]


class PastSelfPlay(TaskLearner):
    """A run of self-play against past policies; see :class:`.learner.TaskLearner`.

    Attributes:
        is_prioritized: whether past policies are met more often the less they are beaten.
    """

    is_prioritized: ClassVar[bool]
    facts = PastFacts
    shown = (*TaskLearner.shown, "beaten")

    def __init__(self, folder: str | Path, arguments: TaskArguments) -> None:
        self._pool = RivalPool(_POOL_SIZE)
        super().__init__(folder, arguments)

    @classmethod
    def arguments_of(cls, task: str, kart_steps: int, seed: int) -> TaskArguments:
        """See :meth:`.learner.TaskLearner.arguments_of`."""
        keep_every = max(kart_steps // _POOL_SIZE, 1)
        return replace(super().arguments_of(task, kart_steps, seed), keep_every=keep_every)

    @classmethod
    def check_task(cls, task: Task) -> None:
        """See :meth:`.learner.TaskLearner.check_task`."""
        super().check_task(task)
        if not can_learn(cls.__name__.lower(), task):
            raise ConfigError(
                f"{task.name} has one learner, and {cls.__name__.lower()} is self-play; use ippo, "
                "which is the same for one learner"
            )

    def save_policy(self, path: Path | None = None) -> Path:
        """Writes the current policy, which becomes a past policy; returns its path."""
        path = super().save_policy(path)
        self._pool.add(path.name)
        return path

    def _new_actors(self, arguments: list[tuple[Any, ...]]) -> ActorPool:
        make = partial(PastActor, folder=self.folder, teams=self.task.teams)
        return ActorPool(make, arguments)

    def _drive_options(self) -> tuple[Any, ...]:
        odds = self._pool.odds()
        return (odds if self.is_prioritized else dict.fromkeys(odds, 1 / max(len(odds), 1)),)

    def _driven(self) -> list[RolloutResult]:
        driven = super()._driven()
        for name, beaten in (duel for own in driven for duel in own.duels):
            self._pool.update(name, beaten)
        return driven

    def _figures(self) -> dict[str, float]:
        rivals = [rival.beaten for rival in self._pool.opponents if rival.races]
        own = {"beaten": float(np.mean(rivals))} if rivals else {}
        return {**super()._figures(), **own}

    def _facts(self) -> dict[str, Any]:
        return {**super()._facts(), "pool": self._pool.state()}

    def _restore(self, facts: Any, state: dict[str, Any], may_change: bool) -> None:
        super()._restore(facts, state, may_change)
        self._pool.restore(facts.pool)
