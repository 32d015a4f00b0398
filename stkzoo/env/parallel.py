"""The core: all karts of one race through PettingZoo's parallel API."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import EzPickle, seeding
from pettingzoo import ParallelEnv

from stkzoo.config import AgentSpec
from stkzoo.engine.assets import Assets, find_assets
from stkzoo.engine.process import can_fork, start_mother
from stkzoo.engine.session import LocalSession, Session, WorkerSession
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.env.branching import BranchingRace
from stkzoo.env.episode import Episode
from stkzoo.env.graphics import graphics_setting
from stkzoo.env.grid import RaceInfo, draw_race
from stkzoo.env.infos import rewards_of_agents
from stkzoo.env.options import (
    RaceOptions,
    check_agents,
    check_engine_timeout,
    check_num_cameras,
    checked_seed,
)
from stkzoo.env.views import views_of_agents
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.mdp.state import state_space
from stkzoo.wrappers.chain import AgentChains

__all__ = ["RaceParallelEnv"]

logger = logging.getLogger(__name__)

Observations = dict[str, Any]
StepResult = tuple[
    Observations, dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
]


class RaceParallelEnv(BranchingRace, ParallelEnv[str, Any, Any], EzPickle):
    """One race of SuperTuxKart in which every agent drives a kart.

    Agents are named ``kart_0`` to ``kart_{n-1}``. An agent whose kart finishes is
    terminated, paid once, and leaves; the race goes on for the others.

    Args:
        agents: a list of :class:`~stkzoo.config.AgentSpec`, or how many; all karts by
            default. Karts beyond the agents are driven by the game.
        num_kart: see :class:`~stkzoo.env.options.RaceOptions`, as for ``track``, ``laps``,
            ``difficulty``, ``max_paths``, ``step_size``, ``reverse`` and ``max_cycles``.
        view: name of a view for all agents (:data:`stkzoo.env.views.VIEWS`), a function
            that wraps a Gymnasium environment, or a mapping from agents to these.
        reward: see :mod:`stkzoo.mdp.rewards`.
        render_mode: ``"human"`` opens the game's window; ``None`` shows nothing.
        num_cameras: how many cameras the window shows.
        graphics_config: a ``pystk2.GraphicsConfig`` or the name of a preset (``"ld"``,
            ``"sd"``, ``"hd"``) for the window.
        use_subprocess: run the game in a process of its own (the default). In this
            process there can be one race at a time, and with bots only the first repeats.
        engine_timeout: seconds that the game may take for one step.
        max_snapshots: how many states saved by this environment may be open at a time;
            each is a process of about a megabyte and two open files.

    Raises:
        ConfigError: an argument cannot be.
        AssetError: the game's data is missing.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's convention
        "name": "race_v0",
        "render_modes": ["human"],
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        *,
        agents: Sequence[AgentSpec] | int | None = None,
        num_kart: int = 3,
        track: str | Sequence[str] | None = None,
        laps: int = 1,
        difficulty: int = 2,
        max_paths: int | None = None,
        render_mode: str | None = None,
        num_cameras: int = 0,
        use_subprocess: bool = True,
        step_size: float | None = 0.1,
        view: Any = "full",
        reward: Any = None,
        reverse: bool = False,
        max_cycles: int | None = 1500,
        graphics_config: Any = None,
        engine_timeout: float = 30.0,
        max_snapshots: int = 100,
    ) -> None:
        arguments = {name: value for name, value in locals().items() if name != "self"}
        EzPickle.__init__(self, **arguments)
        self.options = RaceOptions(
            num_kart=num_kart,
            track=track,
            laps=laps,
            difficulty=difficulty,
            reverse=reverse,
            max_paths=max_paths,
            step_size=0.1 if step_size is None else step_size,
            max_cycles=max_cycles,
        )
        self.specs = _specs(agents, num_kart)
        check_num_cameras(num_cameras)
        check_engine_timeout(engine_timeout)
        BranchingRace.__init__(self, max_snapshots)
        self.render_mode = _checked_render_mode(render_mode, self.metadata["render_modes"])
        self._num_cameras = num_cameras
        self._graphics = graphics_setting(render_mode, graphics_config)
        self._assets = find_assets(graphics=render_mode is not None)
        self.options.tracks(self._assets.tracks)

        check_agents(self.specs, num_kart, self._assets.karts)
        self.possible_agents = [f"kart_{index}" for index in range(len(self.specs))]
        self.agents: list[str] = []
        self._ai_agents = self._agents_of_ai()
        self._rewards = rewards_of_agents(reward, self.possible_agents)
        self._chains = AgentChains(
            {
                agent: kart_observation_space(agent in self._ai_agents)
                for agent in self.possible_agents
            },
            {agent: kart_action_space() for agent in self.possible_agents},
            views_of_agents(view, self.possible_agents),
            ignored=self._ai_agents,
        )
        self.observation_spaces = self._chains.observation_spaces
        self.action_spaces = self._chains.action_spaces
        self.state_space = state_space(num_kart)
        self._np_random: np.random.Generator | None = None
        self._session = _session(
            self._assets, use_subprocess, self._graphics, float(engine_timeout)
        )
        self._episode: Episode | None = None
        self._asked: Episode | None = None  # whose step is under way

    # ------------------------------------------------------------------ PettingZoo's API

    def observation_space(self, agent: str) -> gym.Space[Any]:
        """The agent's observation space: always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gym.Space[Any]:
        """The agent's action space: always the same object."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Starts a new race and returns when all karts stand on the grid and may act.

        Args:
            seed: starts the environment's random stream anew; ``None`` goes on with it.
            options: fields of :class:`~stkzoo.env.options.RaceOptions` for this episode
                alone, except ``num_kart``; others are ignored with a log line. ``state``
                is a :class:`~stkzoo.env.state.RaceState`: the episode starts at that moment
                of that race, with the agents that were racing, and counts from zero; of
                the other options only ``max_cycles`` and ``max_paths`` go with it.

        Returns:
            Observations and infos by agent.
        """
        if seed is not None or self._np_random is None:
            self._np_random, _ = seeding.np_random(checked_seed(seed))
        options_now = self._options_now(options or {})
        self._check_specs()
        state = (options or {}).get("state")
        if state is None:
            agents = list(self.possible_agents)
            self._episode = self._new_race(options_now, self._np_random)
        else:
            agents = self._racing_agents(state, options or {})
            state.resume_in(self._session)
            self._episode = state.moment.episode.anew(options_now, self._rewards)
        self.agents, self._asked = [], None  # in case a wrapper fails
        result = self._chains.reset(
            agents,
            self._episode.observe(agents, self._chains.paths_used),
            self._episode.infos(agents),
            seed=seed,
            options=dict(options or {}),
        )
        self.agents = agents
        return result

    def step(self, actions: Mapping[str, Any]) -> StepResult:
        """Advances the race by one step.

        Args:
            actions: an action for each agent still in the race; entries of agents that
                have left, and of agents that the game's AI drives, are ignored.

        Returns:
            Observations, rewards, terminations, truncations and infos of the agents that
            acted; empty after the end.

        Raises:
            ActionError: an action is missing or cannot be; the race has not moved.
            ApiOrderError: before the first ``reset``.
            EngineError: the game died or hangs; ``reset`` starts anew.
        """
        self.step_async(actions)
        return self.step_wait()

    def step_async(self, actions: Mapping[str, Any]) -> None:
        """Asks for a step, which the game takes while the caller goes on.

        With the game in this process (``use_subprocess=False``) nothing moves before
        :meth:`step_wait`.

        Args:
            actions: as for :meth:`step`.

        Raises:
            ActionError: an action is missing or cannot be; the race has not moved.
            ApiOrderError: before the first ``reset``, or twice without :meth:`step_wait`.
            EngineError: the game died or hangs; ``reset`` starts anew.
        """
        episode, agents = self._running("step"), self.agents
        if self._asked is episode:
            raise ApiOrderError("step_async() twice without step_wait(); call step_wait() first")
        controls = episode.controls(self._chains.decode(actions, agents), agents)
        if agents:
            self._session.step_async(controls)
        self._asked = episode

    def step_wait(self) -> StepResult:
        """What came of the step that :meth:`step_async` asked for; see :meth:`step`.

        Raises:
            ApiOrderError: without :meth:`step_async`.
            EngineError: the game died or hangs; ``reset`` starts anew.
        """
        episode, self._asked = self._asked, None
        if episode is None or episode is not self._episode:
            raise ApiOrderError("step_wait() without step_async(); call step_async() first")
        agents = self.agents
        if not agents:
            return {}, {}, {}, {}, {}
        rewards = episode.advance(self._session.step_wait(), agents)
        terminations = episode.terminations(agents)
        result: StepResult = self._chains.step(
            agents,
            episode.observe(agents, self._chains.paths_used),
            rewards,
            terminations,
            episode.truncations(terminations),
            episode.infos(agents),
        )
        self.agents = [a for a in agents if not (result[2][a] or result[3][a])]
        return result

    def render(self) -> None:
        """With ``render_mode="human"`` the game's window follows every step by itself."""
        if self.render_mode is None:
            warnings.warn(
                'render() shows nothing without a render mode; pass render_mode="human"',
                stacklevel=2,
            )

    def state(self) -> npt.NDArray[np.float32]:
        """The whole race as one vector of ``state_space`` (:mod:`stkzoo.mdp.state`)."""
        return self._running("state").state()

    def close(self) -> None:
        """Ends the game's process; ``reset`` may be called again."""
        self.agents, self._episode, self._asked = [], None, None
        self._session.close()
        self._chains.close()

    def __enter__(self) -> RaceParallelEnv:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # ------------------------------------------------------------------ more than the API

    @property
    def unwrapped(self) -> RaceParallelEnv:
        """This environment."""
        return self

    @property
    def race(self) -> RaceInfo | None:
        """Names of the present race and its karts; ``None`` before the first reset."""
        return self._episode.race if self._episode else None

    @property
    def track_map(self) -> TrackMap | None:
        """The present race's track; ``None`` before the first reset."""
        return self._episode.track_map if self._episode else None

    @property
    def snapshot(self) -> Snapshot | None:
        """The present moment of the race; ``None`` before the first reset."""
        return self._episode.snapshot if self._episode else None

    @property
    def np_random(self) -> np.random.Generator:
        """The environment's random stream, which ``reset(seed=...)`` starts anew."""
        if self._np_random is None:
            self._np_random, _ = seeding.np_random()
        return self._np_random

    @np_random.setter
    def np_random(self, random: np.random.Generator) -> None:
        self._np_random = random

    @property
    def max_cycles(self) -> int | None:
        """Steps after which the race is cut short; ``None`` is never."""
        return self.options.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self.options = replace(self.options, max_cycles=value)

    def observe_batch(self, agents: Sequence[str]) -> dict[str, Any]:
        """What some agents, racing or not, would see now in the ``full`` view.

        Returns:
            Batch form: arrays with a leading axis over ``agents``
            (:mod:`stkzoo.mdp.observations`).
        """
        return self._running("observe_batch").observe(agents)

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """The present infos of some agents, racing or not, before their wrappers."""
        return self._running("infos").infos(agents)

    # ------------------------------------------------------------------ helpers

    def _new_race(self, options: RaceOptions, random: np.random.Generator) -> Episode:
        tracks = options.tracks(self._assets.tracks)
        has_window = self.render_mode == "human"
        setup, race = draw_race(options, self.specs, tracks, self._num_cameras, has_window, random)
        self.agents, self._episode, self._asked = [], None, None  # in case the start fails
        return Episode(options, setup, race, self._session.start(setup), self._rewards)

    def _running(self, method: str) -> Episode:
        if self._episode is None:
            raise ApiOrderError(f"{method}() before reset(); call reset() first")
        return self._episode

    def _agents_of_ai(self) -> set[str]:
        pairs = zip(self.possible_agents, self.specs, strict=True)
        return {agent for agent, spec in pairs if spec.use_ai}

    def _check_specs(self) -> None:
        check_agents(self.specs, self.options.num_kart, self._assets.karts)
        if self._agents_of_ai() != self._ai_agents:
            raise ConfigError(
                "use_ai of an agent was changed after the environment was made, which would "
                "change its spaces; make a new environment"
            )

    def _options_now(self, options: Mapping[str, Any]) -> RaceOptions:
        episode = self.options.changed(options)
        if episode.num_kart != self.options.num_kart:
            raise ConfigError(
                f"options ask for {episode.num_kart} karts in an environment of "
                f"{self.options.num_kart}; make another environment for that"
            )
        unknown = set(options) - set(RaceOptions.__dataclass_fields__) - {"state"}
        if unknown:
            logger.warning("reset() ignores unknown options: %s", ", ".join(map(str, unknown)))
        return episode


def _specs(agents: Sequence[AgentSpec] | int | None, num_kart: int) -> list[AgentSpec]:
    if agents is None:
        agents = num_kart
    if isinstance(agents, (int, np.integer)) and not isinstance(agents, bool):
        return [AgentSpec() for _ in range(agents)]
    if isinstance(agents, Sequence) and not isinstance(agents, str):
        return list(agents)
    raise ConfigError(f"agents is {agents!r}, expected a list of AgentSpec or a number of agents")


def _checked_render_mode(mode: str | None, modes: Sequence[str]) -> str | None:
    if mode is not None and mode not in modes:
        raise ConfigError(f"render_mode is {mode!r}, expected None or one of {', '.join(modes)}")
    return mode


def _session(assets: Assets, use_subprocess: bool, graphics: str, timeout: float) -> Session:
    if not use_subprocess:
        return LocalSession(assets.root, graphics)
    if graphics == "none" and can_fork():
        start_mother(assets.root)  # the game starts while the program goes on
    return WorkerSession(assets.root, graphics, timeout)
