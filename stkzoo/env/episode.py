"""One race from the grid to its end: what the parallel core knows while it lasts."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.race import RaceStart
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.engine.track import decode_track
from stkzoo.env.grid import RaceInfo
from stkzoo.env.infos import EpisodeRecord
from stkzoo.env.options import RaceOptions
from stkzoo.env.scenario import past_controls
from stkzoo.kernel import kernel
from stkzoo.mdp.observations import KartObserver, ai_actions
from stkzoo.mdp.rewards import Reward
from stkzoo.mdp.state import race_state

__all__ = ["Episode"]


class Episode:
    """A race under way.

    Args:
        options: the options of this race.
        setup: what the engine was told.
        race: what was drawn; its kart types are filled in from ``start``.
        start: what the engine answered.
        rewards: every agent's reward, in agent order.

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
    ) -> None:
        self.setup = setup
        self.race = replace(race, kart_types=start.kart_types)
        self.track_map = decode_track(start.track)
        self.snapshot = start.snapshot
        self._kart_of = dict(zip(rewards, race.kart_indices, strict=True))
        self._is_player = np.array([not kart.is_bot for kart in setup.karts])
        self._are_all_players = bool(self._is_player.all())
        self._asked_for: tuple[tuple[str, ...], npt.NDArray[np.intp]] = (), np.empty(0, np.intp)
        self._reports_control = any(kart.reports_control for kart in setup.karts)
        self._past: Any = None  # (what was before, the latest controls), shared by copies
        self._start(options, rewards)

    def copy(self) -> Episode:
        """A copy of this moment; either goes on without touching the other."""
        twin = copy.copy(self)
        shared = {id(reward): reward for reward in self._rewards.values()}
        twin.record = copy.deepcopy(self.record, shared)
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

    def controls(
        self, actions: npt.NDArray[np.float32], agents: Sequence[str]
    ) -> npt.NDArray[np.float32]:
        """What the engine is told: ``(P, 7)`` float32, player karts in grid order.

        Args:
            actions: ``(A, 7)`` float32, the agents' actions with the columns of ``CONTROLS``.
            agents: whose actions; all other player karts coast.
        """
        controls = np.zeros((len(self._is_player), len(CONTROLS)), np.float32)
        controls[self._karts(agents)] = actions
        return controls if self._are_all_players else controls[self._is_player]

    def remember(self, controls: npt.NDArray[np.float32]) -> None:
        """Takes note of what the engine is told in a step."""
        self._past = self._past, controls.tobytes()

    def past_controls(self) -> npt.NDArray[np.float32]:
        """What the engine was told in all steps since the race began: ``(T, P, 7)`` float32."""
        return past_controls(self._past, int(self._is_player.sum()))

    def advance(self, snapshot: Snapshot, agents: Sequence[str]) -> dict[str, float]:
        """Takes in the moment after a step and returns the agents' rewards."""
        rewards = self.record.step(self.snapshot, snapshot, agents)
        self.snapshot = snapshot
        self._num_steps += 1
        return rewards

    def observe(self, agents: Sequence[str], paths_used: int | None = None) -> dict[str, Any]:
        """What some agents see now in the ``full`` view, in batch form.

        Args:
            agents: the agents.
            paths_used: make no more track segments than this.
        """
        karts = self._karts(agents)
        batch = self._observer.observe(self.snapshot, karts, paths_used)
        if self._reports_control:
            batch["action"] = ai_actions(self.snapshot, karts)
        return batch

    def sight(self, agents: Sequence[str], paths_used: int | None) -> Sight:
        """What some agents see now, to be made in the form that is asked for."""
        return Sight(self, self._karts(agents), agents, paths_used)

    def through(self, view: Any, karts: npt.NDArray[np.intp]) -> list[Any]:
        """What some karts see now in a view of the compiled kernel."""
        return self._observer.through(view, self.snapshot, karts)

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Fresh infos of some agents; see :class:`~stkzoo.env.infos.EpisodeRecord`."""
        return self.record.infos(self.snapshot, agents)

    def terminations(self, agents: Sequence[str]) -> dict[str, bool]:
        """Which agents have finished the race."""
        finished = _finished if kernel is None else kernel.finished
        return dict(zip(agents, finished(self.snapshot.karts, self._karts(agents)), strict=True))

    def truncations(self, terminations: Mapping[str, bool]) -> dict[str, bool]:
        """Which agents are cut short because the race has lasted long enough."""
        is_over = self._max_cycles is not None and self._num_steps >= self._max_cycles
        return {agent: is_over and not ended for agent, ended in terminations.items()}

    def state(self) -> npt.NDArray[np.float32]:
        """The whole race as one vector (:mod:`stkzoo.mdp.state`)."""
        agents = self.race.kart_indices
        bots = [kart for kart in range(len(self.snapshot.karts)) if kart not in agents]
        order = np.array([*agents, *bots], np.intp)
        return race_state(self.snapshot, order, self.track_map.length, self.race.laps)

    def _start(self, options: RaceOptions, rewards: Mapping[str, Reward]) -> None:
        """Starts all counts at zero."""
        self._rewards = rewards
        race_length = self.track_map.length * self.race.laps
        self.record = EpisodeRecord(rewards, self.race.kart_indices, race_length)
        self._num_steps = 0
        self._max_cycles = options.max_cycles
        self._observer = KartObserver(self.track_map, self.race.kart_types, options.max_paths)

    def _karts(self, agents: Sequence[str]) -> npt.NDArray[np.intp]:
        key = tuple(agents)
        if key != self._asked_for[0]:  # they change only when somebody leaves
            self._asked_for = key, np.array([self._kart_of[agent] for agent in key], np.intp)
        return self._asked_for[1]


def _finished(karts: npt.NDArray[np.void], who: npt.NDArray[np.intp]) -> list[bool]:
    finished: list[bool] = (karts["has_finished_race"][who] > 0).tolist()
    return finished


class Sight:
    """What some agents of an episode see at its present moment (:class:`wrappers.chain.Sight`)."""

    def __init__(
        self,
        episode: Episode,
        karts: npt.NDArray[np.intp],
        agents: Sequence[str],
        paths_used: int | None,
    ) -> None:
        self._episode, self._karts = episode, karts
        self._agents, self._paths_used = agents, paths_used
        self._batch: dict[str, Any] | None = None

    def batch(self) -> dict[str, Any]:
        """The ``full`` view of all the agents, in batch form."""
        if self._batch is None:
            self._batch = self._episode.observe(self._agents, self._paths_used)
        return self._batch

    def through(self, view: Any, rows: npt.NDArray[np.intp]) -> list[Any]:
        """What the agents of some rows see in a view of the compiled kernel."""
        return self._episode.through(view, self._karts[rows])
