"""The numbers that go with every step of an agent, and the sums over its episode."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agent_names import by_agent, find_agent
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.kernel import kernel
from stkzoo.mdp.rewards import Reward, as_reward
from stkzoo.mdp.transition import Transition

__all__ = ["EpisodeRecord", "rewards_of_agents"]

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]


def rewards_of_agents(choice: object, agents: Sequence[str]) -> dict[str, Reward]:
    """Every agent's reward; see :mod:`stkzoo.mdp.rewards` for what can be chosen."""
    if isinstance(choice, Mapping) and any(_is_agent(name, agents) for name in choice):
        chosen = by_agent(choice, agents)
        return {agent: as_reward(chosen.get(agent)) for agent in agents}
    return dict.fromkeys(agents, as_reward(choice))


@dataclass(frozen=True)
class _Group:
    """Agents that share a reward: their rows, their karts and the columns of the terms."""

    reward: Reward
    rows: IntArray
    karts: IntArray
    columns: IntArray


def _groups(
    rewards: Mapping[str, Reward], karts: Sequence[int], columns: Mapping[str, int]
) -> list[_Group]:
    members: dict[int, list[int]] = {}
    for row, reward in enumerate(rewards.values()):
        members.setdefault(id(reward), []).append(row)
    of_row, kart_of = list(rewards.values()), np.array(karts, np.intp)
    return [
        _Group(
            reward=of_row[rows[0]],
            rows=np.array(rows, np.intp),
            karts=kart_of[rows],
            columns=np.array([columns[name] for name in of_row[rows[0]].terms], np.intp),
        )
        for rows in members.values()
    ]


def _is_agent(name: object, agents: Sequence[str]) -> bool:
    try:
        find_agent(name, agents)
    except ConfigError:
        return False
    return True


class EpisodeRecord:
    """Rewards and infos of one episode.

    Args:
        rewards: every agent's reward, in agent order.
        kart_indices: every agent's kart, in agent order.
        race_length: laps times the lap's length [m].
    """

    def __init__(
        self, rewards: Mapping[str, Reward], kart_indices: Sequence[int], race_length: float
    ) -> None:
        self._agents = tuple(rewards)
        self._karts = np.array(kart_indices, np.intp)
        self._rows = {agent: row for row, agent in enumerate(rewards)}
        names = sorted({name for reward in rewards.values() for name in reward.terms})
        self._groups = _groups(rewards, kart_indices, {name: c for c, name in enumerate(names)})
        self._own_groups = [g for g in self._groups if g.reward.kernel_terms is None]
        self._race_length = race_length
        self._last = np.zeros((len(rewards), len(names)))
        self._sums = np.zeros_like(self._last)
        self._keys = (
            *("position", "distance", "lap", "finish_time"),
            *(f"reward/{name}" for name in names),
            *(f"episode/reward/{name}" for name in names),
            *("episode/return", "episode/length"),
        )

    def step(self, before: Snapshot, after: Snapshot, agents: Sequence[str]) -> dict[str, float]:
        """Adds one step and returns the rewards of the agents that were still racing."""
        self._score(self._groups, before, after)
        self._last[[agent not in agents for agent in self._agents]] = 0.0
        self._sums += self._last
        totals = self._last.sum(axis=1)[self._rows_of(agents)].tolist()
        return dict(zip(agents, totals, strict=True))

    def score_own_terms(self, before: Snapshot, after: Snapshot) -> None:
        """Makes a step's terms of those rewards that the compiled kernel does not know."""
        if self._own_groups:
            self._score(self._own_groups, before, after)

    def outcome(self, agents: Sequence[str], views: Any, course: tuple[Any, ...]) -> Any:
        """The compiled kernel's way to make of each step what these agents get.

        It goes on with this record; after each :meth:`score_own_terms`, its ``step`` takes
        the place of :meth:`step` and :meth:`infos`.

        Args:
            agents: who is racing.
            views: pairs of a ``kernel.View`` and the numbers of the agents that have it.
            course: :attr:`stkzoo.mdp.observations.KartObserver.course`.
        """
        rows = self._rows_of(agents)
        where = {int(row): number for number, row in enumerate(rows)}
        rewards = []
        for group in self._groups:
            terms = group.reward.kernel_terms
            racing = [where[row] for row in group.rows.tolist() if row in where]
            if terms is not None:
                rewards.append((*terms, group.columns, np.array(racing, np.intp)))
        numbers = self._last, self._sums, self._keys, self._race_length
        parts = tuple(rewards), tuple(views)
        assert kernel is not None  # noqa: S101 - it has made the views
        return kernel.Outcome(tuple(agents), self._karts[rows], rows, *numbers, *parts, *course)

    def _score(self, groups: Sequence[_Group], before: Snapshot, after: Snapshot) -> None:
        """Writes a step's reward terms into ``_last``."""
        transition = Transition(before, after, self._race_length)
        for group in groups:
            values = group.reward(transition).values()
            for column, value in zip(group.columns, values, strict=True):
                self._last[group.rows, column] = value[group.karts]

    def infos(
        self, snapshot: Snapshot, agents: Sequence[str], length: int
    ) -> dict[str, dict[str, Any]]:
        """Fresh infos of some agents: plain numbers under the same keys from reset on.

        ``position`` is the rank, ``distance`` the metres driven, ``lap`` the number of
        laps done, ``finish_time`` seconds (0 before the finish), ``reward/<term>`` the
        weighted terms of this step, ``episode/reward/<term>`` their sums,
        ``episode/return`` the sum of all, ``episode/length`` the steps so far (``length``).
        """
        infos = {}
        for agent in agents:
            row = self._rows[agent]
            kart, sums = snapshot.karts[self._karts[row]], self._sums[row].tolist()
            values = [
                int(kart["position"]),
                max(float(kart["overall_distance"]), 0.0),
                max(int(kart["finished_laps"]), 0),
                float(kart["finish_time"]),
                *self._last[row].tolist(),
                *sums,
                reduce(operator.add, sums, 0.0),
                length,
            ]
            infos[agent] = dict(zip(self._keys, values, strict=True))
        return infos

    def _rows_of(self, agents: Sequence[str]) -> IntArray:
        return np.array([self._rows[agent] for agent in agents], np.intp)
