"""The core: all karts of one race through PettingZoo's parallel API."""

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
from stkzoo.config import AgentSpec
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
    from stkzoo.env.opponents import OpponentChoice


Observations = dict[str, Any]


@check_arguments
class RaceParallelEnv(BranchingRace, ParallelEnv[str, Any, Any]):
    """One race of SuperTuxKart in which every agent drives a kart.

    Agents are named ``kart_0`` to ``kart_{n-1}``. An agent whose kart finishes is
    terminated, paid once, and leaves; the race goes on for the others.

    Args:
        agents: a list of :class:`~stkzoo.config.AgentSpec` or mappings of their fields, or how
            many; all karts by default. Karts beyond the agents are driven by the game.
        num_kart: see :class:`~stkzoo.env.options.RaceOptions`, as for ``track``, ``laps``,
            ``difficulty``, ``max_paths``, ``step_size``, ``reverse``, ``max_cycles``,
            ``start``, ``events`` and those that begin with ``end_``.
        view: name of a view for all agents (:data:`stkzoo.views.VIEWS`), a function
            that wraps a Gymnasium environment, or a mapping from agents to these.
        reward: see :mod:`stkzoo.mdp.rewards`.
        render_mode: ``"rgb_array"``: :meth:`render` gives a picture; ``"rgb_array_list"``: the
            pictures since the last call or reset; ``"human"``: the game's window follows the
            race; ``None`` shows nothing. No mode changes a race. Where there is no display,
            ``metadata["render_modes"]`` leaves ``"human"`` out and ``reset`` refuses it.
        num_cameras: how many agents have a camera, at most 8; with 0 those that ask for one,
            or the first agent.
        render_backend: what draws pictures: ``"engine"``, the game; ``"map"``, the race from
            above; ``"auto"``, the game where it can draw, else the map.
        render_size: width and height of a picture [pixels].
        graphics_config: a ``pystk2.GraphicsConfig`` or the name of a preset (``"ld"``,
            ``"sd"``, ``"hd"``): how finely the game draws.
        use_subprocess: run the game in a process of its own (the default). In this
            process there can be one race at a time, and with bots only the first repeats.
        engine_timeout: seconds that the game may take for one step.
        max_snapshots: how many states saved by this environment may be open at a time;
            each is a process of about a megabyte and two open files.
        opponents: drivers of further karts, which are no agents: a list of names
            (:func:`stkzoo.race.find_driver`), policies, drivers and pools, one for each; or a
            :class:`~stkzoo.OpponentPool`, which drives all karts that are no agents. A mapping
            from names to weights is a pool.

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
        reverse: bool = False,
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
        """The agent's observation space: always the same object."""
        return of_agent(self.observation_spaces, agent)

    def action_space(self, agent: str) -> gym.Space[Any]:
        """The agent's action space: always the same object."""
        return of_agent(self.action_spaces, agent)

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        """Starts a new race and returns when all karts stand on the grid and may act.

        Args:
            seed: restarts the environment's random stream; ``None`` goes on with it.
            options: fields of :class:`~stkzoo.env.options.RaceOptions` for this episode
                alone, except ``num_kart``. ``state``
                is a :class:`~stkzoo.env.state.RaceState`: the episode starts at that moment
                of that race, with the agents that were racing, and counts from zero; of
                the other options only ``max_cycles``, ``max_paths``, ``events`` and those that
                begin with ``end_`` go with it. ``scenario``
                is a :class:`~stkzoo.env.scenario.Scenario` or the path of its file: the
                same with a moment that was kept as a file.

        Returns:
            Observations and infos by agent.

        Raises:
            ApiOrderError: another thread's call runs, as for all methods that change the race.
            ConfigError: an option is invalid, or there is no display for ``"human"``.
        """
        with self._turn.of("reset"):
            return self._reset(seed, options)

    def _reset(
        self, seed: int | None, options: Mapping[str, Any] | None
    ) -> tuple[Observations, dict[str, dict[str, Any]]]:
        self._rendering.check()
        if seed is not None or self._np_random is None:
            self._np_random = random_stream(seed)
        options = {} if options is None else options
        options_now = self._options_now(options)
        self._check_specs()
        if options.get("scenario") is not None:
            found = self._from_scenario(options["scenario"], options, options_now)
        elif options.get("state") is not None:
            found = self._from_state(options["state"], options, options_now)
        else:
            found = list(self.possible_agents), self._new_race(options_now, options)
        agents, self._episode = found
        self.agents, self._asked = [], None  # in case a wrapper fails
        result = self._chains.reset(
            agents,
            self._episode,
            self._episode.infos(agents),
            seed=seed,
            options=dict(options),
        )
        self.agents = agents
        self._rendering.reset(self._episode)
        return result

    def step(self, actions: Mapping[str, Any]) -> StepParts:
        """Advances the race by one step.

        Its phases: :meth:`decode` makes controls of the actions, opponents add theirs,
        :meth:`send` steps the game, and :meth:`step_wait` reads the moment after it, scores
        rewards and ends, observes and gathers infos. Wrappers that the kernel does not do run
        last.

        Args:
            actions: an action for each agent still in the race; entries of agents that
                have left, and of agents that the game's AI drives, are ignored.

        Returns:
            Observations, rewards, terminations, truncations and infos of the agents that
            acted; empty after the end.

        Raises:
            ActionError: an action is missing or invalid; the race has not moved.
            ApiOrderError: before the first ``reset``, or another thread's call runs.
            EngineError: the game died or hangs; ``reset`` starts a new race.
        """
        turn = self._turn
        if not turn.lock.acquire(blocking=False):
            turn.claim("step")
        turn.call = "step"
        try:
            self._request_step(actions)
            return self._finish_step()
        finally:
            turn.lock.release()

    def step_async(self, actions: Mapping[str, Any]) -> None:
        """Asks for a step, which the game takes while the caller goes on.

        With the game in this process (``use_subprocess=False``) nothing moves before
        :meth:`step_wait`.

        Args:
            actions: as for :meth:`step`.

        Raises:
            ActionError: an action is missing or invalid; the race has not moved.
            ApiOrderError: before the first ``reset``, or twice without :meth:`step_wait`.
            EngineError: the game died or hangs; ``reset`` starts a new race.
        """
        with self._turn.of("step_async"):
            self._request_step(actions)

    def _request_step(self, actions: Mapping[str, Any]) -> None:
        controls = self.decode(actions)
        drive_opponents([self], [controls])
        self.send(controls)

    def decode(self, actions: Mapping[str, Any]) -> npt.NDArray[np.float32]:
        """The first half of :meth:`step_async`: checks the actions and moves nothing.

        Returns:
            What :meth:`send` takes: ``(P, 7)`` float32, see
            :meth:`stkzoo.engine.session.Session.step_async`.
        """
        episode = self._running("step")
        if self._asked is episode:
            raise ApiOrderError("step_async() twice without step_wait(); call step_wait() first")
        rows = episode.player_rows(self.agents)
        return self._chains.decode(actions, self.agents, rows, episode.num_players, episode)

    def send(self, controls: npt.NDArray[np.float32]) -> None:
        """The second half of :meth:`step_async`: asks the game for the step."""
        if self.agents:
            self._session.step_async(controls)
            self._running("step").remember(controls)
        self._asked = self._running("step")

    def step_wait(self) -> StepParts:
        """What came of the step that :meth:`step_async` asked for; see :meth:`step`.

        Raises:
            ApiOrderError: without :meth:`step_async`.
            EngineError: the game died or hangs; ``reset`` starts a new race.
        """
        with self._turn.of("step_wait"):
            return self._finish_step()

    def _finish_step(self) -> StepParts:
        episode, self._asked = self._asked, None
        if episode is None or episode is not self._episode:
            raise ApiOrderError("step_wait() without step_async(); call step_async() first")
        agents = self.agents
        if not agents:
            return {}, {}, {}, {}, {}
        snapshot = self._session.step_wait()
        rewards, terminations, truncations = episode.advance(snapshot, agents)
        observations = self._chains.observe(agents, episode)
        infos = episode.infos(agents)
        parts = observations, rewards, terminations, truncations, infos
        self._chains.finish(agents, parts)
        if any(terminations.values()) or any(truncations.values()):
            self.agents = [a for a in agents if not (terminations[a] or truncations[a])]
        if self.render_mode is not None:
            self._rendering.follow(episode)
        return parts

    def render(self) -> Any:
        """Shows the race as ``render_mode`` asks for.

        Returns:
            ``(height, width, 3)`` uint8 with ``"rgb_array"``: what the first agent's camera
            sees, several cameras as tiles, or the map. A list of such pictures, one a step
            since the last call or reset, with ``"rgb_array_list"``. ``None`` with ``"human"``:
            the window follows every step by itself.

        Raises:
            ApiOrderError: before the first ``reset``.
            EngineError: the game cannot draw here, and the map was not allowed.
        """
        return self._rendering.render(self._episode)

    def frames(self) -> dict[str, npt.NDArray[np.uint8]]:
        """What each agent's camera sees, ``(height, width, 3)`` uint8; in any render mode.

        Raises: as :meth:`render`.
        """
        return self._rendering.frames(self._episode, self.possible_agents)

    def state(self) -> npt.NDArray[np.float32]:
        """The whole race as one vector of ``state_space`` (:mod:`stkzoo.mdp.state`)."""
        return self._running("state").state()

    def close(self) -> None:
        """Ends the game's process; ``reset`` may be called again."""
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

    # ------------------------------------------------------------------ more than the API

    @property
    def unwrapped(self) -> RaceParallelEnv:
        """This environment."""
        return self

    @property
    def render_backend(self) -> str:
        """What draws: ``"engine"`` or ``"map"``; ``"auto"`` until a picture was asked for."""
        return self._rendering.backend

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
        episode = self._running("observe_batch")
        if isinstance(agents, str) or not isinstance(agents, Sequence) or not agents:
            raise ConfigError(f"agents is {agents!r}, expected a list of one agent or more")
        return episode.observe_batch([find_agent(agent, self.possible_agents) for agent in agents])

    def observe(self, agents: Sequence[str]) -> Observations:
        """What some agents, racing or not, see now, before wrappers of your own."""
        return self._chains.observe(agents, self._running("observe"))

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """The present infos of some agents, racing or not, before their wrappers."""
        return self._running("infos").infos(agents)

    # ------------------------------------------------------------------ helpers

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
        drawn = setup, kart_indices, begun
        episode = Episode(options, *drawn, self._rewards, self._assets.root)
        if self._opponents is not None:
            self._opponents.begin(drivers, episode)
        return episode

    def _draw_opponents(
        self, options: RaceOptions, asked: Mapping[str, Any], random: np.random.Generator
    ) -> tuple[RaceOptions, tuple[Driver, ...], list[AgentSpec]]:
        """The options of a race with its opponents, their drivers, and how they start."""
        if self._opponents is None:
            return options, (), []
        drivers, level = self._opponents.draw(random, asked.get("difficulty"))
        options = options if level is None else replace(options, difficulty=level)
        return options, drivers, self._opponents.specs(drivers)

    def _begin(self, setup: RaceSetup) -> RaceStart:
        """Starts a race."""
        return self._session.start(setup)

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
        known = (*RaceOptions.__dataclass_fields__, "state", "scenario")
        for name in options:
            # PettingZoo's conformance tests reset with {"options": 1}.
            if name not in (*known, "options"):
                raise unknown_name("option", name, known)
        return episode


def drive_opponents(
    races: Sequence[RaceParallelEnv], controls: Sequence[npt.NDArray[np.float32]]
) -> None:
    """Adds the opponents' controls to those that :meth:`RaceParallelEnv.decode` gave.

    Args:
        races: races that are about to be stepped, the karts of one driver together.
        controls: of each race.
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
    """What was asked for as opponents, and how many there are."""
    if opponents is None:
        return None, 0
    from stkzoo.env.opponents import OpponentChoice

    choice = OpponentChoice.of(opponents)
    given = len(agents) if isinstance(agents, Sequence) else agents
    return choice, choice.count(given, num_kart)


def _specs(
    agents: Sequence[AgentSpec | Mapping[str, object]] | int | None, num_kart: int
) -> list[AgentSpec]:
    if agents is None:
        agents = num_kart
    if isinstance(agents, (int, np.integer)) and not isinstance(agents, bool):
        # One too many is refused with the rest; more would only take up memory.
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
