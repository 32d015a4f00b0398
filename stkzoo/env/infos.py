"""The numbers that go with every step of an agent, and the sums over its episode."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.kernel import kernel
from stkzoo.mdp.rewards import Reward, as_reward
from stkzoo.mdp.transition import Transition
from stkzoo.wrappers.agent_names import by_agent, find_agent

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
        self._all_rows = np.arange(len(rewards))
        self._race_length = race_length
        self._last = np.zeros((len(rewards), len(names)))
        self._sums = np.zeros_like(self._last)
        self._length = 0
        self._keys = (
            *("position", "distance", "lap", "finish_time"),
            *(f"reward/{name}" for name in names),
            *(f"episode/reward/{name}" for name in names),
            *("episode/return", "episode/length"),
        )

    def step(self, before: Snapshot, after: Snapshot, agents: Sequence[str]) -> dict[str, float]:
        """Adds one step and returns the rewards of the agents that were still racing."""
        for group in self._groups:
            self._score(group, before, after)
        if len(agents) < len(self._agents):
            self._last[[agent not in agents for agent in self._agents]] = 0.0
        self._length += 1
        add_up = _add_up if kernel is None else kernel.add_up
        return dict(zip(agents, add_up(self._last, self._sums, self._rows_of(agents)), strict=True))

    def _score(self, group: _Group, before: Snapshot, after: Snapshot) -> None:
        """Writes a step's reward terms into ``_last``."""
        terms = group.reward.kernel_terms
        if kernel is not None and terms is not None:
            places = (group.columns, group.rows, group.karts, self._last)
            kernel.score(before.karts, after.karts, self._race_length, *terms, *places)
            return
        values = group.reward(Transition(before, after, self._race_length)).values()
        for column, value in zip(group.columns, values, strict=True):
            self._last[group.rows, column] = value[group.karts]

    def infos(self, snapshot: Snapshot, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Fresh infos of some agents: plain numbers under the same keys from reset on.

        ``position`` is the rank, ``distance`` the metres driven, ``lap`` the number of
        laps done, ``finish_time`` seconds (0 before the finish), ``reward/<term>`` the
        weighted terms of this step, ``episode/reward/<term>`` their sums,
        ``episode/return`` the sum of all, ``episode/length`` the steps so far.
        """
        rows = self._rows_of(agents)
        moment = (snapshot.karts, self._last, self._sums, self._length, rows, self._karts)
        make = _make_infos if kernel is None else kernel.make_infos
        return dict(zip(agents, make(self._keys, *moment), strict=True))

    def _rows_of(self, agents: Sequence[str]) -> IntArray:
        if len(agents) == len(self._agents):
            return self._all_rows  # agents keep their order
        return np.array([self._rows[agent] for agent in agents], np.intp)


def _add_up(last: FloatArray, sums: FloatArray, rows: IntArray) -> list[float]:
    """Adds a step's terms to their sums; the totals of some rows."""
    sums += last
    totals: list[float] = last.sum(axis=1)[rows].tolist()
    return totals


def _make_infos(
    keys: tuple[str, ...],
    karts: npt.NDArray[np.void],
    last: FloatArray,
    sums: FloatArray,
    length: int,
    rows: IntArray,
    kart_of_row: IntArray,
) -> list[dict[str, Any]]:
    """One info for each of some rows of ``last`` and ``sums``."""
    infos = []
    for row, kart in zip(rows.tolist(), karts[kart_of_row[rows]], strict=True):
        own = sums[row].tolist()
        values = [
            int(kart["position"]),
            max(float(kart["overall_distance"]), 0.0),
            max(int(kart["finished_laps"]), 0),
            float(kart["finish_time"]),
            *last[row].tolist(),
            *own,
            reduce(operator.add, own, 0.0),
            length,
        ]
        infos.append(dict(zip(keys, values, strict=True)))
    return infos
