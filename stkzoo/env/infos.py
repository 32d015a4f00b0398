"""The numbers that go with every step of an agent, and the sums over its episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.mdp.rewards import Reward, as_reward
from stkzoo.mdp.transition import Transition, progress_of
from stkzoo.wrappers.agent_names import by_agent, find_agent

__all__ = ["EpisodeRecord", "rewards_of_agents"]

FloatArray = npt.NDArray[np.float64]


def rewards_of_agents(choice: object, agents: Sequence[str]) -> dict[str, Reward]:
    """Every agent's reward; see :mod:`stkzoo.mdp.rewards` for what can be chosen."""
    if isinstance(choice, Mapping) and any(_is_agent(name, agents) for name in choice):
        chosen = by_agent(choice, agents)
        return {agent: as_reward(chosen.get(agent)) for agent in agents}
    return dict.fromkeys(agents, as_reward(choice))


def _groups(
    rewards: Mapping[str, Reward], karts: Mapping[str, int]
) -> list[tuple[Reward, list[int], list[int]]]:
    """Agents that share a reward: the reward, their rows and their karts."""
    groups: list[tuple[Reward, list[int], list[int]]] = []
    for row, (agent, reward) in enumerate(rewards.items()):
        group = next((known for known in groups if known[0] is reward), None)
        if group is None:
            groups.append(group := (reward, [], []))
        group[1].append(row)
        group[2].append(karts[agent])
    return groups


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
        self._karts = dict(zip(rewards, kart_indices, strict=True))
        self._groups = _groups(rewards, self._karts)
        names = sorted({name for reward in rewards.values() for name in reward.terms})
        self._columns = {name: column for column, name in enumerate(names)}
        self._rows = {agent: row for row, agent in enumerate(rewards)}
        self._race_length = race_length
        self._last = np.zeros((len(rewards), len(names)))
        self._sums = np.zeros_like(self._last)
        self._length = 0

    def step(self, before: Snapshot, after: Snapshot, agents: Sequence[str]) -> dict[str, float]:
        """Adds one step and returns the rewards of the agents that were still racing."""
        transition = Transition(before, after, self._race_length)
        for reward, rows, karts in self._groups:
            for name, values in reward(transition).items():
                self._last[rows, self._columns[name]] = values[karts]
        if len(agents) < len(self._agents):
            self._last[[agent not in agents for agent in self._agents]] = 0.0
        self._sums += self._last
        self._length += 1
        totals = dict(zip(self._agents, self._last.sum(axis=1).tolist(), strict=True))
        return {agent: totals[agent] for agent in agents}

    def infos(self, snapshot: Snapshot, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Fresh infos of some agents: plain numbers under the same keys from reset on.

        ``position`` is the rank, ``distance`` the metres driven, ``lap`` the number of
        laps done, ``finish_time`` seconds (0 before the finish), ``reward/<term>`` the
        weighted terms of this step, ``episode/reward/<term>`` their sums,
        ``episode/return`` the sum of all, ``episode/length`` the steps so far.
        """
        distances = progress_of(snapshot).tolist()
        karts = snapshot.karts
        infos: dict[str, dict[str, Any]] = {}
        for agent in agents:
            row, kart = self._rows[agent], self._karts[agent]
            last, sums = self._last[row].tolist(), self._sums[row].tolist()
            infos[agent] = {
                "position": int(karts["position"][kart]),
                "distance": distances[kart],
                "lap": max(int(karts["finished_laps"][kart]), 0),
                "finish_time": float(karts["finish_time"][kart]),
                **{f"reward/{name}": last[c] for name, c in self._columns.items()},
                **{f"episode/reward/{name}": sums[c] for name, c in self._columns.items()},
                "episode/return": sum(sums),
                "episode/length": self._length,
            }
        return infos
