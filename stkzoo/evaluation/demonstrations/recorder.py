"""A recorder of demonstrations, which listens to a race."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._checks import check_name
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError
from stkzoo.evaluation.demonstrations.dataset import Demonstrations, EpisodeFacts, columns_of, join
from stkzoo.mdp import action_of, controls_of, kart_action_space, kart_observation_space
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import RaceResult
from stkzoo.views import VIEWS, extras_for
from stkzoo.views.agent_chain import AgentChain

_STEP = 0.1  # usual time between two observations [s]
#: Buttons that count as pressed if they were pressed in any part of a step. Other buttons must be
#: pressed in at least half of the parts.
_PULSES = np.array([name in ("fire", "nitro", "rescue") for name in CONTROLS])
_ANALOGUE = np.array([name in ("acceleration", "steer") for name in CONTROLS])
#: The reward of each step, however long the step is.
_TIME = "reward/time"

Controls = npt.NDArray[np.float32]


class DemoView:
    """The view in which a demonstration is recorded.

    Args:
        name: name of a view with a fixed size, made of stkzoo's own wrappers.

    Raises:
        ConfigError: the view does not exist, or recording does not support it.
    """

    def __init__(self, name: str) -> None:
        check_name("view", name, VIEWS)
        if extras_for(VIEWS[name]):
            raise ConfigError(
                f"view {name!r} shows the ground, which recordings do not have; record in racing, "
                "simple, or a flattened view"
            )
        full = kart_observation_space()
        self._keys = tuple(full.spaces)
        self._seeing = AgentChain("kart_0", full, kart_action_space(), VIEWS[name])
        if not self._seeing.is_pure or not self._seeing.observation_space.is_np_flattenable:
            raise ConfigError(
                f"observations in view {name!r} differ in size from step to step, or depend on "
                "earlier ones; record in racing, simple, or a flattened view"
            )
        self._acting = AgentChain(
            "kart_0", kart_observation_space(use_ai=True), kart_action_space(), VIEWS[name]
        )
        self.observation_space = self._seeing.observation_space
        self.action_space = self._seeing.action_space

    def observe(self, observation: Mapping[str, Any]) -> Any:
        """Converts an observation in the view ``full`` to this view."""
        return self._seeing.reset({key: observation[key] for key in self._keys}, {})[0]

    def action(self, observation: Mapping[str, Any], controls: Controls) -> Any:
        """Returns the action in this view that is nearest to controls ``(7,)``.

        Args:
            observation: an observation in the view ``full``. It does not affect the result.
            controls: controls of the game.
        """
        seen, _ = self._acting.reset({**observation, "action": action_of(controls)}, {})
        return seen["action"]


class DemoRecorder(RaceListener):
    """A race listener that records the observations and actions of agents.

    Args:
        agents: number of agents to record, beginning with the first agent of the race.
        view: the view to record in.
        substeps: number of equal parts of a step. The controls of the game's AI are read after
            each part, because the AI decides several times per step. Its recorded action has the
            mean of its steering and acceleration. It has the buttons fire, nitro and rescue if
            they were pressed in any part, and other buttons if pressed in at least half of the
            parts.
        race: number of the race in the dataset.
        step_size: time between two observations [s].
    """

    def __init__(
        self,
        agents: int,
        view: DemoView,
        substeps: int = 1,
        race: int = 0,
        step_size: float = _STEP,
    ) -> None:
        self._count, self._view, self._substeps, self._race = agents, view, substeps, race
        self._step_size = step_size
        self._karts: dict[str, _Kart] = {}
        self._parts: list[Demonstrations] = []

    def env_options(self) -> dict[str, Any]:
        """See :class:`~stkzoo.race.RaceListener`."""
        return {"step_size": self._step_size / self._substeps}

    def started(self, race: RaceProgress) -> None:
        """Records the observations on the grid."""
        agents = race.env.possible_agents[: self._count]
        self._karts = {agent: _Kart(self._view, race.observations[agent]) for agent in agents}

    def stepped(self, race: RaceProgress) -> None:
        """Records the actions, and the observations at the end of a step."""
        is_whole = race.steps % self._substeps == 0
        for agent, kart in self._karts.items():
            if kart.is_over:
                continue
            observation, info = race.observations[agent], race.infos[agent]
            done = observation["action"] if "action" in observation else race.actions[agent]
            kart.controls.append(np.array(controls_of(done), np.float32))
            kart.rewards.append((race.rewards[agent], info[_TIME]))
            kart.is_over = info["finish_time"] > 0
            if is_whole or kart.is_over:
                kart.ends.append(len(kart.rewards))
                kart.observations.append(self._view.observe(observation))

    def ended(self, result: RaceResult) -> None:
        """Builds the episodes."""
        rows = {row.agent: row for row in result.agents}
        for agent, kart in self._karts.items():
            row = rows[agent]
            if not kart.ends:
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
                mode=result.mode,
            )
            lengths = np.array([len(kart.ends)], np.int64)
            self._parts.append(Demonstrations({}, (facts,), lengths, kart.columns(self._view)))

    def episodes(self, plan: Mapping[str, Any]) -> Demonstrations | None:
        """Returns the recorded episodes; ``None`` if no agent took a step.

        Args:
            plan: see :class:`Demonstrations`.
        """
        return replace(join(self._parts), plan=plan) if self._parts else None


class _Kart:
    """The episode of one kart during recording.

    Controls and rewards have one entry per part of a step. ``ends`` has the number of parts at the
    end of each step.
    """

    def __init__(self, view: DemoView, observation: Any) -> None:
        self._first = observation
        self.observations = [view.observe(observation)]
        self.controls: list[Controls] = []
        self.rewards: list[tuple[float, float]] = []  # total, and its part for time
        self.ends: list[int] = []
        self.is_over = False

    def columns(self, view: DemoView) -> dict[str, npt.NDArray[Any]]:
        """Returns the episode as arrays.

        The reward of a step is the sum over its parts, with the reward for time once.
        """
        steps = list(zip([0, *self.ends[:-1]], self.ends, strict=True))
        controls = [_together(np.stack(self.controls[begin:end])) for begin, end in steps]
        totals, times = np.array(self.rewards).T
        rewards = [sum(totals[begin:end]) - sum(times[begin : end - 1]) for begin, end in steps]
        actions = [view.action(self._first, control) for control in controls]
        return {
            **columns_of("observations", view.observation_space, self.observations),
            **columns_of("actions", view.action_space, actions),
            "controls": np.stack(controls),
            "rewards": np.array(rewards, np.float64),
        }


def _together(parts: Controls) -> Controls:
    """Merges the controls ``(n, 7)`` of the parts of a step into ``(7,)``."""
    means = parts.mean(axis=0)
    pressed = np.where(_PULSES, parts.any(axis=0), means >= 0.5)
    together: Controls = np.where(_ANALOGUE, means, pressed).astype(np.float32)
    return together
