"""The parallel environment: all karts of one race behind PettingZoo's parallel API."""

from __future__ import annotations

import weakref
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import EzPickle
from pettingzoo import ParallelEnv

from stkzoo.agent_names import find_agent, of_agent
from stkzoo.config import NORMAL, AgentSpec
from stkzoo.engine.assets import Assets, find_assets
from stkzoo.engine.fork_client import can_fork, start_fork_server
from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import LocalSession, Session, WorkerSession
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.env.branching import BranchingRace
from stkzoo.env.cameras import RaceCameras
from stkzoo.env.episode import Episode, rewards_of_agents
from stkzoo.env.grid import draw_race
from stkzoo.env.options import MAX_CAMERAS, RaceOptions, check_agents, random_stream
from stkzoo.env.rendering import RENDER_MODES, Rendering, available_modes, frame_rate
from stkzoo.env.starts import MAX_START_DRAWS, is_random
from stkzoo.errors import (
    ApiOrderError,
    ConfigError,
    check_arguments,
    check_number,
    check_whole,
    unknown_name,
)
from stkzoo.mdp.spaces import kart_action_space
from stkzoo.mdp.state import state_space
from stkzoo.views import base_space, views_of_agents
from stkzoo.views.chains import AgentChains
from stkzoo.views.walker import StepParts

if TYPE_CHECKING:
    from stkzoo.drivers import Driver
    from stkzoo.env.opponent_choice import OpponentChoice


Observations = dict[str, Any]


@check_arguments
class RaceParallelEnv(BranchingRace, ParallelEnv[str, Any, Any]):
    """One race of SuperTuxKart in which every agent drives a kart.

    Agents are named ``kart_0`` to ``kart_{n-1}``. When an agent's kart finishes, the agent gets its
    last reward, is terminated and leaves; the race continues for the others.

    Args:
        agents: a list of :class:`~stkzoo.config.AgentSpec` or mappings of their fields, or the
            number of agents; by default, all karts are agents. The game drives the remaining karts.
        num_kart: see :class:`~stkzoo.env.options.RaceOptions`; likewise ``track``, ``laps``,
            ``difficulty``, ``max_paths``, ``step_size``, ``reverse``, ``mode``, ``max_cycles``,
            ``start``, ``events`` and the options that begin with ``end_``.
        view: name of a view for all agents (:data:`stkzoo.views.VIEWS`), a function that wraps a
            Gymnasium environment, or a mapping from agents to views.
        reward: see :mod:`stkzoo.mdp.rewards`.
        render_mode: with ``"rgb_array"``, :meth:`render` returns a frame; with
            ``"rgb_array_list"``, the frames since the last call or reset; with ``"human"``, a game
            window follows the race; ``None`` disables rendering. The render mode does not affect
            the race. On a machine without a display, ``metadata["render_modes"]`` lacks ``"human"``
            and ``reset`` rejects it.
        num_cameras: number of agents with a camera, at most 8. With 0, the agents that request a
            camera get one, or else the first agent.
        render_backend: renderer of the frames: ``"engine"``, the game; ``"map"``, a top-down map;
            ``"auto"``, the game if it can render on this machine, otherwise the map.
        render_size: width and height of a frame [pixels].
        graphics_config: graphics quality: a ``pystk2.GraphicsConfig`` or the name of a preset
            (``"ld"``, ``"sd"``, ``"hd"``).
        use_subprocess: run the game in its own process (the default). Otherwise the game runs in
            this process, which allows only one race at a time; with bots, only the first race is
            reproducible.
        engine_timeout: time limit of the game for one step [s].
        max_snapshots: maximum number of open states saved by this environment. Each is a process of
            about 1 MB with two open files.
        opponents: drivers of additional karts, which are not agents. Either a list of driver names
            (:func:`stkzoo.race.find_driver`), policies, drivers and pools, one per kart; or an
            :class:`~stkzoo.OpponentPool`, which drives all karts that are not agents. A mapping
            from names to weights also defines a pool.

    Raises:
        ConfigError: an argument is invalid.
        AssetError: the game's data is missing.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's convention
        "name": "race_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        *,
        agents: Sequence[AgentSpec | Mapping[str, object]] | int | None = None,
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
        reverse: bool | None = False,
        max_cycles: int | None = 1500,
        render_backend: str = "auto",
        render_size: Sequence[int] = (640, 480),
        graphics_config: Any = None,
        engine_timeout: float = 30.0,
        max_snapshots: int = 100,
        start: Any = None,
        opponents: Any = None,
        events: bool = False,
        end_when_stuck: float | None = None,
        end_when_wrong_way: float | None = None,
        end_off_road: float | None = None,
        end_when_first_finishes: int | None = None,
        mode: str = NORMAL,
    ) -> None:
        arguments = {name: value for name, value in locals().items() if name != "self"}
        EzPickle.__init__(self, **arguments)
        arguments["step_size"] = 0.1 if step_size is None else step_size
        chosen = {name: arguments[name] for name in RaceOptions.__dataclass_fields__}
        self.options = RaceOptions(**chosen)
        choice, num_opponents = _opponents(opponents, agents, num_kart)
        self.specs = _specs(agents, num_kart - num_opponents)
        check_whole("num_cameras", num_cameras, 0, MAX_CAMERAS)
        engine_timeout = check_number("engine_timeout", engine_timeout, 1e-3, 1e6)
        self._opponents = None
        BranchingRace.__init__(self, max_snapshots)
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_modes": available_modes(),
            "render_fps": frame_rate(self.options.step_size),
        }
        self._rendering = Rendering(render_mode, render_backend, render_size, graphics_config)
        self._num_cameras = num_cameras
        self._assets = find_assets()
        self.options.tracks(self._assets.tracks)

        check_agents(self.specs, num_kart, self._assets.karts)
        self.possible_agents = [f"kart_{index}" for index in range(len(self.specs))]
        self._ai_agents = self._agents_of_ai()
        self._rewards = rewards_of_agents(reward, self.possible_agents)
        this = weakref.ref(self)  # cameras do not keep the environment alive
        self.cameras = RaceCameras(self.possible_agents, lambda: getattr(this(), "_episode", None))
        views = views_of_agents(view, self.possible_agents)
        self._chains = AgentChains(
            {agent: base_space(own, agent in self._ai_agents) for agent, own in views.items()},
            {agent: kart_action_space() for agent in self.possible_agents},
            self.cameras.connected(views),
            ignored=self._ai_agents,
            columns=CONTROLS,
        )
        self.observation_spaces = self._chains.observation_spaces
        self.action_spaces = self._chains.action_spaces
        self.state_space = state_space(num_kart)
        if choice is not None:
            from stkzoo.env.opponents import RaceOpponents

            view = next(iter(views.values()))
            self._opponents = RaceOpponents(choice, len(self.specs), num_opponents, view)
        self._session = _session(self._assets, use_subprocess, engine_timeout)

    # ------------------------------------------------------------------ PettingZoo's API

    def observation_space(self, agent: str) -> gym.Space[Any]:
        """Returns the agent's observation space, the same object on every call.

        Args:
            agent: the agent's id.
        """
        return of_agent(self.observation_spaces, agent)

    def action_space(self, agent: str) -> gym.Space[Any]:
        """Returns the agent's action space, the same object on every call.

        Args:
            agent: the agent's id.
        """
        return of_agent(self.action_spaces, agent)

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Starts a new race and returns when the karts are on the grid and may act.

        Args:
            seed: seeds the environment's random generator; ``None`` keeps its current state.
            options: fields of :class:`~stkzoo.env.options.RaceOptions` for this episode, except
                ``num_kart``. Two further keys start the episode in the middle of a race. ``state``
                is a :class:`~stkzoo.env.state.RaceState`: the episode starts at the saved moment,
                with the agents that were racing, and its counters start at zero. You may combine it
                with ``max_cycles``, ``max_paths``, ``events`` and options that begin with ``end_``.
                ``scenario`` is a :class:`~stkzoo.env.scenario.Scenario` or the path of its file,
                and works like ``state``.

        Returns:
            Observations and infos by agent.

        Raises:
            ApiOrderError: another thread's call runs, as for all methods that change the race.
            ConfigError: an option is invalid, or there is no display for ``"human"``.
            EngineError: the game does not start.
        """
        with self._turn.of("reset"):
            if seed is not None or self._np_random is None:
                self._np_random = random_stream(seed)
            return self._reset(seed, options)

    def _reset(
        self, seed: int | None, options: Mapping[str, Any] | None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Starts a race with the current random generator; ``seed`` is for the wrappers only."""
        self._rendering.check()
        options = {} if options is None else options
        options_now = self._options_now(options)
        self._check_specs()
        with self._exchange():
            if options.get("scenario") is not None:
                agents, self._episode = self._from_scenario(
                    options["scenario"], options, options_now
                )
            elif options.get("state") is not None:
                agents, self._episode = self._from_state(options["state"], options, options_now)
            else:
                agents = list(self.possible_agents)
                self._episode = self._new_race(options_now, options)
            self.agents, self._stepping = [], None  # in case a wrapper fails
        seats = self._episode.seats(agents)
        result = self._chains.reset(
            seats,
            self._episode,
            self._episode.infos(seats),
            seed=seed,
            options=dict(options),
        )
        self.agents = agents
        self._rendering.reset(self._episode)
        return result

    def step(self, actions: Mapping[str, Any]) -> StepParts:
        """Advances the race by one step.

        The step has these phases: :meth:`decode` converts actions to controls, the opponents add
        their controls, :meth:`send` starts the step in the game, and :meth:`step_wait` reads the
        new state, computes rewards and episode ends, and builds observations and infos. Wrappers
        without a kernel implementation run last.

        Args:
            actions: one action per agent that is still racing. Actions of agents that have left, or
                that the game's AI drives, are ignored.

        Returns:
            Observations, rewards, terminations, truncations and infos of the agents that acted;
                empty dicts after the race has ended.

        Raises:
            ActionError: an action is missing or invalid; the race has not advanced.
            ApiOrderError: called before the first ``reset``, or while another thread's call runs.
            EngineError: the game crashed or hung; ``reset`` starts a new race.
        """
        turn = self._turn
        if not turn.lock.acquire(blocking=False):
            raise turn.conflict("step")
        turn.call = "step"
        try:
            self._request_step(actions)
            return self._finish_step()
        finally:
            turn.lock.release()

    def step_async(self, actions: Mapping[str, Any]) -> None:
        """Starts a step and returns while the game computes it.

        With the game in this process (``use_subprocess=False``), the race advances in
        :meth:`step_wait`.

        Args:
            actions: see :meth:`step`.

        Raises:
            ActionError: an action is missing or invalid; the race has not advanced.
            ApiOrderError: called before the first ``reset``, or twice without :meth:`step_wait`.
            EngineError: the game crashed or hung; ``reset`` starts a new race.
        """
        with self._turn.of("step_async"):
            self._request_step(actions)

    def _request_step(self, actions: Mapping[str, Any]) -> None:
        controls = self.decode(actions)
        if self._opponents is not None:
            drive_opponents([self], [controls])
        self.send(controls)

    def decode(self, actions: Mapping[str, Any]) -> npt.NDArray[np.float32]:
        """First half of :meth:`step_async`: checks the actions and converts them to controls.

        Args:
            actions: see :meth:`step`.

        Returns:
            Controls of the P player karts for :meth:`send`, ``(P, 7)`` float32; see
                :meth:`stkzoo.engine.session.Session.step_async`.

        Raises:
            ActionError: an action is missing or invalid.
            ApiOrderError: called before the first ``reset``, or while a step is running.
        """
        episode = self._idle_episode()
        return self._chains.decode(actions, episode.seats(self.agents), episode)

    def send(self, controls: npt.NDArray[np.float32]) -> None:
        """Second half of :meth:`step_async`: starts the step in the game.

        Args:
            controls: controls from :meth:`decode`, ``(P, 7)`` float32.
        """
        episode = self._running("step")
        if self.agents:
            self._session.step_async(controls)
            episode.remember(controls)
        self._stepping = episode

    def step_wait(self) -> StepParts:
        """Waits for the step from :meth:`step_async` and returns its result; see :meth:`step`.

        Raises:
            ApiOrderError: called without :meth:`step_async`.
            EngineError: the game crashed or hung; ``reset`` starts a new race.
        """
        with self._turn.of("step_wait"):
            return self._finish_step()

    def _finish_step(self) -> StepParts:
        episode, agents = self._awaited_episode(), self.agents
        try:  # until the episode has advanced, signal handlers cannot save or copy the race
            if not agents:
                return {}, {}, {}, {}, {}
            seats = episode.seats(agents)
            ends = episode.advance(self._session.step_wait(), seats)
        finally:
            self._stepping = None
        rewards, terminations, truncations = ends
        observations = self._chains.observe(seats, episode)
        infos = episode.infos(seats)
        parts = observations, rewards, terminations, truncations, infos
        self._chains.finish(seats, parts)
        if any(terminations.values()) or any(truncations.values()):
            self.agents = [a for a in agents if not (terminations[a] or truncations[a])]
        if self.render_mode is not None:
            self._rendering.follow(episode)
        return parts

    def render(self) -> Any:
        """Renders the race according to ``render_mode``.

        Returns:
            With ``"rgb_array"``, a frame ``(height, width, 3)`` uint8: the view of the first
                agent's camera, several cameras as tiles, or the map. With ``"rgb_array_list"``, a
                list of frames, one per step since the last call or reset. With ``"human"``,
                ``None``: the window updates after every step.

        Raises:
            ApiOrderError: called before the first ``reset``.
            EngineError: the game cannot render on this machine and ``render_backend`` is
                ``"engine"``.
        """
        return self._rendering.render(self._episode)

    def frames(self) -> dict[str, npt.NDArray[np.uint8]]:
        """Returns each agent's camera frame, ``(height, width, 3)`` uint8, in any render mode.

        Raises:
            ApiOrderError: called before the first ``reset``.
            EngineError: the game cannot render on this machine and ``render_backend`` is
                ``"engine"``.
        """
        return self._rendering.frames(self._episode, self.possible_agents)

    def state(self) -> npt.NDArray[np.float32]:
        """Returns the state of the race: a vector in ``state_space`` (:mod:`stkzoo.mdp.state`).

        Raises:
            ApiOrderError: called before the first ``reset``.
        """
        return self._running("state").state()

    def close(self) -> None:
        """Stops the game process. You may call ``reset`` again."""
        with self._turn.of("close"):
            self._end_race()
            self._session.close()
            self._rendering.close()
            self.cameras.close()
            self._chains.close()

    def __enter__(self) -> RaceParallelEnv:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    # ------------------------------------------------------------------ beyond the API

    @property
    def unwrapped(self) -> RaceParallelEnv:
        """This environment."""
        return self

    @property
    def render_backend(self) -> str:
        """Renderer in use: ``"engine"`` or ``"map"``; ``"auto"`` before the first frame."""
        return self._rendering.backend

    @property
    def step_size(self) -> float:
        """Game time of one step of the current race, or of the next one before a reset [s]."""
        return self._episode.step_size if self._episode else self.options.step_size

    @property
    def max_cycles(self) -> int | None:
        """Number of steps after which the race is truncated; ``None`` for no limit."""
        return self.options.max_cycles

    @max_cycles.setter
    def max_cycles(self, value: int | None) -> None:
        self.options = replace(self.options, max_cycles=value)

    def observe_batch(self, agents: Sequence[str]) -> dict[str, Any]:
        """Returns current observations in the ``full`` view, in batch form.

        Args:
            agents: ids of the agents, racing or not; at least one.

        Returns:
            Arrays with a leading axis over ``agents`` (:mod:`stkzoo.mdp.observations`).

        Raises:
            ApiOrderError: called before the first ``reset``.
            ConfigError: ``agents`` is not a list of agents.
        """
        episode = self._running("observe_batch")
        ids = self._ids_of(agents)
        if not ids:
            raise ConfigError("agents is empty, expected a list of one agent or more")
        return episode.observe_batch(ids)

    def observe(self, agents: Sequence[str]) -> Observations:
        """Returns the agents' current observations, before custom wrappers.

        Args:
            agents: ids of the agents, racing or not.

        Raises:
            ApiOrderError: called before the first ``reset``.
            ConfigError: ``agents`` is not a list of agents.
        """
        episode = self._running("observe")
        return self._chains.observe(episode.seats(self._ids_of(agents)), episode)

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Returns the agents' current infos, before their wrappers.

        Args:
            agents: ids of the agents, racing or not.

        Raises:
            ApiOrderError: called before the first ``reset``.
            ConfigError: ``agents`` is not a list of agents.
        """
        episode = self._running("infos")
        return episode.infos(episode.seats(self._ids_of(agents)))

    # ------------------------------------------------------------------ helpers

    def _ids_of(self, agents: Sequence[str]) -> list[str]:
        if isinstance(agents, str) or not isinstance(agents, Sequence):
            raise ConfigError(f"agents is {agents!r}, expected a list of agents")
        known = self._chains.observation_spaces
        return [
            agent if isinstance(agent, str) and agent in known else find_agent(agent, known)
            for agent in agents
        ]

    def _new_race(self, options: RaceOptions, asked: Mapping[str, Any]) -> Episode:
        random = self.np_random
        options, drivers, opponents = self._draw_opponents(options, asked, random)
        tracks = options.tracks(self._assets.tracks)
        has_window = self.render_mode == "human"
        self._end_race()  # in case the start fails
        for draws_left in reversed(range(MAX_START_DRAWS)):
            setup, kart_indices = draw_race(
                options, self.specs, tracks, self._num_cameras, has_window, random, opponents
            )
            try:
                begun = self._begin(setup)
                break
            except ConfigError:  # a place where no kart can stand
                if not draws_left or not is_random(options.start):
                    raise
        root = self._assets.root
        episode = Episode(options, setup, kart_indices, begun, self._rewards, root)
        if self._opponents is not None:
            self._opponents.begin(drivers, episode)
        return episode

    def _draw_opponents(
        self, options: RaceOptions, asked: Mapping[str, Any], random: np.random.Generator
    ) -> tuple[RaceOptions, tuple[Driver, ...], list[AgentSpec]]:
        """Draws the opponents; returns the race's options, the drivers and their specs."""
        if self._opponents is None:
            return options, (), []
        drivers, level = self._opponents.draw(random, asked.get("difficulty"))
        options = options if level is None else replace(options, difficulty=level)
        return options, drivers, self._opponents.specs(drivers)

    def _begin(self, setup: RaceSetup) -> RaceStart:
        """Starts a race in the game; :class:`~stkzoo.env.vec.ahead.AheadRace` overrides it."""
        return self._session.start(setup)

    def _running(self, method: str) -> Episode:
        if self._episode is None:
            raise ApiOrderError(f"{method}() before reset(); call reset() first")
        return self._episode

    def _idle_episode(self) -> Episode:
        """Returns the running episode; raises if it is already stepping."""
        episode = self._running("step")
        if self._stepping is episode:
            raise ApiOrderError("step_async() twice without step_wait(); call step_wait() first")
        return episode

    def _awaited_episode(self) -> Episode:
        """Returns the episode that is stepping. The caller finishes its step and forgets it."""
        episode = self._stepping
        if episode is None or episode is not self._episode:
            raise ApiOrderError("step_wait() without step_async(); call step_async() first")
        return episode

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
                f"options request {episode.num_kart} karts, but this environment has "
                f"{self.options.num_kart}; make another environment"
            )
        known = (*RaceOptions.__dataclass_fields__, "state", "scenario")
        for name in options:
            # PettingZoo's conformance tests reset with {"options": 1}.
            if name not in (*known, "options"):
                raise unknown_name("option", name, known)
        return episode


def drive_opponents(
    races: Sequence[RaceParallelEnv], controls: Sequence[npt.NDArray[np.float32]]
) -> None:
    """Adds the opponents' controls to those from :meth:`RaceParallelEnv.decode`.

    Karts of the same driver are computed together, also across races.

    Args:
        races: the races that are about to step.
        controls: controls of each race, ``(P, 7)`` float32; changed in place.
    """
    driven = [
        (race._opponents, race._running("step"), own)
        for race, own in zip(races, controls, strict=True)
        if race._opponents is not None and race._opponents.is_driving and race.agents
    ]
    if driven:
        from stkzoo.env.opponents import drive_together

        drive_together(driven)


def _opponents(
    opponents: Any, agents: Sequence[object] | int | None, num_kart: int
) -> tuple[OpponentChoice | None, int]:
    """Reads the ``opponents`` argument; returns the choice and the number of opponents."""
    if opponents is None:
        return None, 0
    from stkzoo.env.opponent_choice import OpponentChoice

    choice = OpponentChoice.of(opponents)
    given = len(agents) if isinstance(agents, Sequence) else agents
    return choice, choice.count(given, num_kart)


def _specs(
    agents: Sequence[AgentSpec | Mapping[str, object]] | int | None, num_kart: int
) -> list[AgentSpec]:
    if agents is None:
        agents = num_kart
    if isinstance(agents, (int, np.integer)) and not isinstance(agents, bool):
        # One agent too many is enough for the later check to reject; more only cost memory.
        return [AgentSpec() for _ in range(min(int(agents), num_kart + 1))]
    if isinstance(agents, Sequence) and not isinstance(agents, str):
        return [AgentSpec.of(agent, f"agent {number}") for number, agent in enumerate(agents)]
    raise ConfigError(f"agents is {agents!r}, expected a list of AgentSpec or a number of agents")


def _session(assets: Assets, use_subprocess: bool, timeout: float) -> Session:
    if not isinstance(use_subprocess, (bool, int, np.bool_)):
        raise ConfigError(f"use_subprocess is {use_subprocess!r}, expected True or False")
    if not use_subprocess:
        return LocalSession(assets.root)
    if can_fork():
        start_fork_server(assets.root)  # the game starts while the program goes on
    return WorkerSession(assets.root, timeout=timeout)
