"""One race from the grid to its end: what the parallel core knows while it lasts."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.ground import Ground, ground_of
from stkzoo.engine.race import RaceStart
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import decode_track
from stkzoo.env.grid import RaceInfo
from stkzoo.env.infos import EpisodeRecord
from stkzoo.env.options import RaceOptions
from stkzoo.env.scenario import past_controls
from stkzoo.kernel import kernel
from stkzoo.mdp.observations import KartObserver, ai_actions
from stkzoo.mdp.rewards import Reward
from stkzoo.mdp.state import race_state
from stkzoo.views.chains import AgentChains, StepParts
from stkzoo.wrappers.racing import GroundSight, RacingSight, ground_table

__all__ = ["Episode"]

IntArray = npt.NDArray[np.intp]


class Episode:
    """A race under way.

    Args:
        options: the options of this race.
        setup: what the engine was told.
        race: what was drawn; its kart types are filled in from ``start``.
        start: what the engine answered.
        rewards: every agent's reward, in agent order.
        root: of the game's data.

    Attributes:
        setup: what the engine was told.
        race: names of the race and its karts.
        track_map: the track.
        snapshot: the present moment.
        record: rewards and infos.
    """

    def __init__(
        self,
        options: RaceOptions,
        setup: RaceSetup,
        race: RaceInfo,
        start: RaceStart,
        rewards: Mapping[str, Reward],
        root: Path,
    ) -> None:
        self.setup, self._root = setup, root
        self.race = replace(race, kart_types=start.kart_types)
        self.track_map = decode_track(start.track)
        self.snapshot = start.snapshot
        self._kart_of = dict(zip(rewards, race.kart_indices, strict=True))
        self._players = np.flatnonzero([not kart.is_bot for kart in setup.karts])
        nobody = np.empty(0, np.intp)
        self._asked_for: tuple[tuple[str, ...], tuple[IntArray, IntArray]] = (), (nobody, nobody)
        self._reports_control = any(kart.reports_control for kart in setup.karts)
        self._outcome: tuple[Any, Any] | None = None  # (for whom, kernel.Outcome)
        self._past: Any = None  # (what was before, the latest controls), shared by copies
        self._start(options, rewards)

    def copy(self) -> Episode:
        """A copy of this moment; either goes on without touching the other."""
        twin = copy.copy(self)
        shared = {id(reward): reward for reward in self._rewards.values()}
        twin.record = copy.deepcopy(self.record, shared)
        twin._outcome = None
        return twin

    def anew(self, options: RaceOptions, rewards: Mapping[str, Reward]) -> Episode:
        """An episode that starts at this moment of this race.

        Args:
            options: of which ``max_cycles`` and ``max_paths`` count.
            rewards: every agent's reward, in agent order.
        """
        twin = copy.copy(self)
        twin._start(options, rewards)
        return twin

    @property
    def num_players(self) -> int:
        """How many karts the engine is told what to do."""
        return len(self._players)

    def player_rows(self, agents: Sequence[str]) -> IntArray:
        """Which of the karts that the engine is told what to do are the agents'.

        Those of agents that the game's AI drives are none of them.
        """
        return self._places(agents)[1]

    def remember(self, controls: npt.NDArray[np.float32]) -> None:
        """Takes note of what the engine is told in a step."""
        self._past = self._past, controls.tobytes()

    def past_controls(self) -> npt.NDArray[np.float32]:
        """What the engine was told in all steps since the race began: ``(T, P, 7)`` float32."""
        return past_controls(self._past, self.num_players)

    def advance(self, snapshot: Snapshot, agents: Sequence[str], chains: AgentChains) -> StepParts:
        """Takes in the moment after a step.

        Args:
            snapshot: the moment.
            agents: the agents that acted.
            chains: their wrappers.

        Returns:
            What the agents get: observations, rewards, terminations, truncations and infos.
        """
        before, self.snapshot = self.snapshot, snapshot
        self._num_steps += 1
        is_over = self._max_cycles is not None and self._num_steps >= self._max_cycles
        if kernel is None:
            parts = self._told(before, agents, is_over)
        else:
            self.record.score_own_terms(before, snapshot)
            outcome = self._outcome_for(agents, chains)
            parts = outcome.step(before.data, snapshot.data, is_over, self._num_steps)
        return chains.step(agents, self.sight(agents, chains), parts)

    def _outcome_for(self, agents: Sequence[str], chains: AgentChains) -> Any:
        whom = chains, tuple(agents)
        if self._outcome is None or self._outcome[0] != whom:
            views = chains.views(agents)
            self._outcome = whom, self.record.outcome(agents, views, self._observer.course)
        return self._outcome[1]

    def _told(self, before: Snapshot, agents: Sequence[str], is_over: bool) -> StepParts:
        """What a step means for the agents, without what they see."""
        rewards = self.record.step(before, self.snapshot, agents)
        finished = self.snapshot.karts["has_finished_race"][self._karts(agents)] > 0
        terminations = dict(zip(agents, finished.tolist(), strict=True))
        truncations = {agent: is_over and not ended for agent, ended in terminations.items()}
        return dict.fromkeys(agents), rewards, terminations, truncations, self.infos(agents)

    def observe(
        self, agents: Sequence[str], paths_used: int | None = None, sees_ground: bool = False
    ) -> dict[str, Any]:
        """What some agents see now in the ``full`` view, in batch form.

        Args:
            agents: the agents.
            paths_used: make no more track segments than this.
            sees_ground: add what is beside the road ahead.
        """
        karts = self._karts(agents)
        batch = self._observer.observe(self.snapshot, karts, paths_used)
        if self._reports_control:
            batch["action"] = ai_actions(self.snapshot, karts)
        if sees_ground:
            batch |= self._ground_ahead(karts)
        return batch

    @property
    def ground(self) -> Ground:
        """What karts drive on and run into on the track."""
        race = self.race
        return ground_of(self.track_map, race.track, self._root, reverse=race.reverse)

    def sight(self, agents: Sequence[str], chains: AgentChains) -> Sight:
        """What some agents see now, to be made in the form that their chains ask for."""
        return Sight(self, self._karts(agents), agents, chains)

    def through(self, view: Any, karts: IntArray) -> list[Any] | None:
        """What some karts see now in a view that needs no batch (``views/compile.py``)."""
        if isinstance(view, RacingSight):
            return view.observe(self.track_map, self.snapshot, karts, self._observer.max_paths)
        if isinstance(view, GroundSight):
            seen = self._observer.through(view.rest, self.snapshot, karts)
            return view.added(seen, self._ground_ahead(karts))
        return self._observer.through(view, self.snapshot, karts)

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Fresh infos of some agents; see :class:`~stkzoo.env.infos.EpisodeRecord`."""
        return self.record.infos(self.snapshot, agents, self._num_steps)

    def state(self) -> npt.NDArray[np.float32]:
        """The whole race as one vector (:mod:`stkzoo.mdp.state`)."""
        agents = self.race.kart_indices
        bots = [kart for kart in range(len(self.snapshot.karts)) if kart not in agents]
        order = np.array([*agents, *bots], np.intp)
        return race_state(self.snapshot, order, self.track_map.length, self.race.laps)

    def _ground_ahead(self, karts: IntArray) -> dict[str, Any]:
        records = self.snapshot.karts[karts]
        ahead = ground_table(self.track_map, self.ground).ahead(
            records["node"], records["location"]
        )
        return {"ground_kind": ahead.kind, "ground_speed": ahead.speed}

    def _start(self, options: RaceOptions, rewards: Mapping[str, Reward]) -> None:
        """Starts all counts at zero."""
        self._rewards = rewards
        race_length = self.track_map.length * self.race.laps
        self.record = EpisodeRecord(rewards, self.race.kart_indices, race_length)
        self._outcome = None
        self._num_steps = 0
        self._max_cycles = options.max_cycles
        self._observer = KartObserver(self.track_map, self.race.kart_types, options.max_paths)

    def _karts(self, agents: Sequence[str]) -> IntArray:
        return self._places(agents)[0]

    def _places(self, agents: Sequence[str]) -> tuple[IntArray, IntArray]:
        """The agents' karts, and their rows among the players."""
        key = tuple(agents)
        if key != self._asked_for[0]:  # they change only when somebody leaves
            karts = np.array([self._kart_of[agent] for agent in key], np.intp)
            self._asked_for = key, (karts, np.searchsorted(self._players, karts))
        return self._asked_for[1]


class Sight:
    """What some agents of an episode see at its present moment (:class:`wrappers.chain.Sight`)."""

    def __init__(
        self,
        episode: Episode,
        karts: IntArray,
        agents: Sequence[str],
        chains: AgentChains,
    ) -> None:
        self._episode, self._karts = episode, karts
        self._agents, self._chains = agents, chains
        self._batch: dict[str, Any] | None = None

    def batch(self) -> dict[str, Any]:
        """The ``full`` view of all the agents, in batch form."""
        if self._batch is None:
            self._batch = self._episode.observe(
                self._agents, self._chains.paths_used, self._chains.sees_ground
            )
        return self._batch

    def through(self, view: Any, rows: IntArray) -> list[Any] | None:
        """What the agents of some rows see in a view that needs no batch."""
        return self._episode.through(view, self._karts[rows])
