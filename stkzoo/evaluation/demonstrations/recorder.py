"""Records some karts of a race."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError, unknown_name
from stkzoo.evaluation.demonstrations.dataset import (
    Columns,
    Demonstrations,
    EpisodeFacts,
    join,
)
from stkzoo.mdp.spaces import columns_of, kart_action_space, kart_observation_space
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay import action_of, controls_of
from stkzoo.race.result import RaceResult
from stkzoo.views import VIEWS, sees_ground
from stkzoo.views.agent_chain import AgentChain

#: Time from one observation to the next [s].
STEP = 0.1
#: Buttons that count as pressed if pressed at any moment of a step; the others need half of it.
_PULSES = np.array([name in ("fire", "nitro", "rescue") for name in CONTROLS])
_ANALOGUE = np.array([name in ("acceleration", "steer") for name in CONTROLS])
_PROGRESS = "reward/progress"

Controls = npt.NDArray[np.float32]


class DemoView:
    """The view that a demonstration is recorded in: its observations and actions.

    Args:
        name: of a view of fixed size, made of stkzoo's own wrappers.

    Raises:
        ConfigError: there is no such view, or recording does not support it.
    """

    def __init__(self, name: str) -> None:
        if name not in VIEWS:
            raise unknown_name("view", name, VIEWS)
        if sees_ground(VIEWS[name]):
            raise ConfigError(
                f"view {name!r} shows the ground, which recordings do not have; record in racing, "
                "simple, or a flattened view"
            )
        full = kart_observation_space()
        self._keys = tuple(full.spaces)
        self._seeing = AgentChain("kart_0", full, kart_action_space(), VIEWS[name])
        if not self._seeing.is_pure or not self._seeing.observation_space.is_np_flattenable:
            raise ConfigError(
                f"observations in view {name!r} differ in size from step to step, or need their "
                "past; record in racing, simple, or a flattened view"
            )
        with_action = kart_observation_space(use_ai=True), kart_action_space()
        self._acting = AgentChain("kart_0", *with_action, VIEWS[name])
        self.observation_space = self._seeing.observation_space
        self.action_space = self._seeing.action_space

    def observe(self, observation: Mapping[str, Any]) -> Any:
        """The view's observation of a ``full`` observation."""
        return self._seeing.observe({key: observation[key] for key in self._keys})

    def action(self, observation: Mapping[str, Any], controls: Controls) -> Any:
        """The view's action nearest to some controls ``(7,)``; any observation will do."""
        return self._acting.observe({**observation, "action": action_of(controls)})["action"]


class DemoRecorder(RaceListener):
    """Records the observations and actions of some agents.

    Args:
        agents: the number of agents; the first ones of the race are recorded.
        view: the view to record in.
        substeps: a step is driven in this many equal parts, and the controls of the game's AI are
            read after each. The AI decides many times per step; its action is the mean of its
            steering and throttle, and every button that it pressed.
        race: number of the race in the data set.
    """

    def __init__(self, agents: int, view: DemoView, substeps: int = 1, race: int = 0) -> None:
        self._count, self._view, self._substeps, self._race = agents, view, substeps, race
        self._tracks: dict[str, _Kart] = {}
        self._parts: list[Demonstrations] = []

    def env_options(self) -> dict[str, Any]:
        """See :class:`~stkzoo.race.RaceListener`."""
        return {"step_size": STEP / self._substeps}

    def started(self, race: RaceProgress) -> None:
        """Records the observations on the grid."""
        agents = race.env.possible_agents[: self._count]
        self._tracks = {agent: _Kart(self._view, race.observations[agent]) for agent in agents}

    def stepped(self, race: RaceProgress) -> None:
        """Records the actions, and the observations at a step's end."""
        is_whole = race.steps % self._substeps == 0
        for agent, kart in self._tracks.items():
            if kart.is_over:
                continue
            observation, info = race.observations[agent], race.infos[agent]
            done = observation["action"] if "action" in observation else race.actions[agent]
            kart.add(np.array(controls_of(done), np.float32), race.rewards[agent], info[_PROGRESS])
            kart.is_over = info["finish_time"] > 0
            if is_whole or kart.is_over:
                kart.end_step(observation)

    def ended(self, result: RaceResult) -> None:
        """Builds the episodes."""
        rows = {row.agent: row for row in result.agents}
        for agent, kart in self._tracks.items():
            row = rows[agent]
            if not kart.length:
                continue
            facts = EpisodeFacts(
                race=self._race,
                agent=agent,
                track=result.track,
                reverse=result.reverse,
                seed=result.seed,
                start_position=row.start_position,
                finish_time=row.finish_time,
                rank=row.rank,
            )
            lengths = np.array([kart.length], np.int64)
            self._parts.append(Demonstrations({}, (facts,), lengths, kart.columns()))

    def episodes(self, plan: Mapping[str, Any]) -> Demonstrations | None:
        """The recorded episodes; ``None`` if no agent took a step.

        Args:
            plan: see :class:`Demonstrations`.
        """
        return replace(join(self._parts), plan=plan) if self._parts else None


class _Kart:
    """The episode of one kart so far."""

    def __init__(self, view: DemoView, observation: Any) -> None:
        self._view, self._last = view, observation
        self._observations = [view.observe(observation)]
        self._actions: list[Any] = []
        self._controls: list[Controls] = []
        self._rewards: list[float] = []
        self._parts: list[Controls] = []
        self._progress = self._rest = 0.0
        self.is_over = False

    @property
    def length(self) -> int:
        """Steps so far."""
        return len(self._actions)

    def add(self, controls: Controls, reward: float, progress: float) -> None:
        """Adds a part of a step: progress is summed, all else is that of the step's end."""
        self._parts.append(controls)
        self._progress += progress
        self._rest = reward - progress

    def end_step(self, observation: Any) -> None:
        """Ends the step with the observation after it."""
        controls = _together(np.stack(self._parts))
        self._controls.append(controls)
        self._actions.append(self._view.action(self._last, controls))
        self._rewards.append(self._progress + self._rest)
        self._observations.append(self._view.observe(observation))
        self._parts, self._progress, self._last = [], 0.0, observation

    def columns(self) -> Columns:
        """The episode as arrays."""
        view = self._view
        return {
            **columns_of(
                "observations", view.observation_space, self._observations[: self.length + 1]
            ),
            **columns_of("actions", view.action_space, self._actions),
            "controls": np.stack(self._controls),
            "rewards": np.array(self._rewards),
        }


def _together(parts: Controls) -> Controls:
    """Merges the controls ``(n, 7)`` of a step's parts into ``(7,)``."""
    means = parts.mean(axis=0)
    pressed = np.where(_PULSES, parts.any(axis=0), means >= 0.5)
    together: Controls = np.where(_ANALOGUE, means, pressed).astype(np.float32)
    return together
