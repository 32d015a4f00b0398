"""The parallel environment: all karts of one race behind PettingZoo's parallel API."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.utils import EzPickle
from pettingzoo import ParallelEnv

from stkzoo._checks import check_arguments, check_flag, check_number, check_type, check_whole
from stkzoo.agent_names import find_agent, of_agent
from stkzoo.config import NORMAL, AgentSpec
from stkzoo.engine.assets import Assets, find_assets
from stkzoo.engine.fork_client import can_fork, start_fork_server
from stkzoo.engine.session import LocalSession, Session, WorkerSession
from stkzoo.engine.setup import MAX_CAMERAS
from stkzoo.env.episode import rewards_of_agents
from stkzoo.env.front import RaceFront
from stkzoo.env.options import RaceOptions, check_agents, random_stream
from stkzoo.env.race import Race
from stkzoo.env.rendering import RENDER_MODES, Rendering, available_modes, frame_rate
from stkzoo.errors import ConfigError
from stkzoo.mdp.state import state_space
from stkzoo.views import views_of_agents
from stkzoo.views.walker import StepParts

if TYPE_CHECKING:
    from stkzoo.env.opponent_choice import OpponentChoice


Observations = dict[str, Any]


@check_arguments
class RaceParallelEnv(RaceFront, ParallelEnv[str, Any, Any]):
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
        render_mode: with ``"rgb_array"``, :meth:`render` returns a frame; with ``"human"``, a game
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
        opponents: drivers of additional karts, which are not agents. Either a list of driver names
            (:func:`stkzoo.race.find_driver`), policies, drivers and pools, one per kart; or an
            :class:`~stkzoo.OpponentPool`, which drives all karts that are not agents. A mapping
            from names to weights also defines a pool.

    Attributes:
        live_race: the ``stkzoo.env.race.Race`` that this environment drives.
        specs: options of the agents.
        ai_agents: agents that the game's AI drives; their actions are optional and ignored.
        cameras: the agents' cameras.

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
        options = RaceOptions(**{n: arguments[n] for n in RaceOptions.__dataclass_fields__})
        choice, num_opponents = _opponents(opponents, agents, num_kart)
        specs = _specs(agents, num_kart - num_opponents)
        check_whole("num_cameras", num_cameras, 0, MAX_CAMERAS)
        engine_timeout = check_number("engine_timeout", engine_timeout, 1e-3, 1e6)
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_modes": available_modes(),
            "render_fps": frame_rate(options.step_size),
        }
        rendering = Rendering(render_mode, render_backend, render_size, graphics_config)
        assets = find_assets()
        options.tracks(assets.tracks)
        check_agents(specs, num_kart, assets.karts)
        self.possible_agents = [f"kart_{index}" for index in range(len(specs))]
        rewards = rewards_of_agents(reward, self.possible_agents)
        views = views_of_agents(view, self.possible_agents)
        self.state_space = state_space(num_kart)
        drivers = None
        if choice is not None:
            from stkzoo.env.opponents import RaceOpponents

            drivers = RaceOpponents(choice, len(specs), num_opponents, next(iter(views.values())))
        self.live_race = race = Race(
            options=options,
            specs=specs,
            rewards=rewards,
            assets=assets,
            new_session=partial(_session, assets, use_subprocess, engine_timeout),
            views=views,
            rendering=rendering,
            opponents=drivers,
            num_cameras=num_cameras,
        )
        self.specs, self.ai_agents, self.cameras = specs, race.ai_agents, race.cameras
        self.observation_spaces = race.chains.observation_spaces
        self.action_spaces = race.chains.action_spaces

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
        race = self.live_race
        with race.turn:
            if seed is not None:
                race.np_random = random_stream(seed)
            return race.start(seed, {} if options is None else options)

    def step(self, actions: Mapping[str, Any]) -> StepParts:
        """Advances the race by one step.

        The step has these phases: actions are converted to controls, the opponents add their
        controls, and the game advances. Then rewards and ends, observations and infos are made.
        Wrappers without a kernel implementation run last.

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
        race = self.live_race
        with race.turn:
            race.request(actions)
            return race.finish()

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
        with self.live_race.turn:
            self.live_race.request(actions)

    def step_wait(self) -> StepParts:
        """Waits for the step from :meth:`step_async` and returns its result; see :meth:`step`.

        Raises:
            ApiOrderError: called without :meth:`step_async`.
            EngineError: the game crashed or hung; ``reset`` starts a new race.
        """
        with self.live_race.turn:
            return self.live_race.finish()

    def state(self) -> npt.NDArray[np.float32]:
        """Returns the state of the race: a vector in ``state_space`` (:mod:`stkzoo.mdp.state`).

        Raises:
            ApiOrderError: called before the first ``reset``.
        """
        return self.live_race.running("state").state()

    def __enter__(self) -> RaceParallelEnv:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def agents(self) -> list[str]:
        """Agents that are still racing."""
        return self.live_race.agents

    @property
    def step_size(self) -> float:
        """Game time of one step of the current race, or of the next one before a reset [s]."""
        return self.race.step_size if self.race else self.options.step_size

    def observe(self, agents: Sequence[str]) -> Observations:
        """Returns the agents' current observations, before custom wrappers.

        Args:
            agents: ids of the agents, racing or not.

        Raises:
            ApiOrderError: called before the first ``reset``.
            ConfigError: ``agents`` is not a list of agents.
        """
        return self.live_race.observe(self._ids_of(agents))

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Returns the agents' current infos, before their wrappers.

        Args:
            agents: ids of the agents, racing or not.

        Raises:
            ApiOrderError: called before the first ``reset``.
            ConfigError: ``agents`` is not a list of agents.
        """
        return self.live_race.infos(self._ids_of(agents))

    def _ids_of(self, agents: Sequence[str]) -> list[str]:
        check_type("agents", agents, Sequence, "a list of agents")
        return [find_agent(agent, self.possible_agents) for agent in agents]


def _opponents(
    opponents: Any, agents: Sequence[object] | int | None, num_kart: int
) -> tuple[OpponentChoice | None, int]:
    """Reads the ``opponents`` argument; returns the choice and the number of opponents."""
    if opponents is None:
        return None, 0
    from stkzoo.env.opponent_choice import OpponentChoice

    choice = OpponentChoice.of(opponents)
    num_agents = len(agents) if isinstance(agents, Sequence) else agents
    return choice, choice.count(num_agents, num_kart)


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
    if not check_flag("use_subprocess", use_subprocess):
        return LocalSession(assets.root)
    if can_fork():
        start_fork_server(assets.root)  # the game starts while the program goes on
    return WorkerSession(assets.root, timeout=timeout)
