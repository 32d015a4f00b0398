"""Gymnasium environments of a race, with one agent or with a dictionary of agents."""

from __future__ import annotations

import copy
import inspect
import re
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, ClassVar, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle

from stkzoo._checks import check_whole, unknown_argument
from stkzoo._left_out import LeftOutNames
from stkzoo.config import AgentSpec
from stkzoo.engine.assets import find_assets
from stkzoo.engine.fork_client import can_fork, start_fork_server
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import Snapshot
from stkzoo.env.front import RaceFront, RaceOption
from stkzoo.env.ids import warn_of_time_limit
from stkzoo.env.keyboard import keys_to_action
from stkzoo.env.options import use_known_karts
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.race import Started
from stkzoo.env.rendering import RENDER_MODES
from stkzoo.env.world import WorldView
from stkzoo.errors import ActionError, ApiOrderError, ConfigError
from stkzoo.mdp.rewards import RewardOver
from stkzoo.mdp.spaces import kart_observation_space
from stkzoo.views import find_view, options_of, views_of_agents
from stkzoo.views.chains import RecordsObserver
from stkzoo.views.plan import ViewPlan
from stkzoo.views.walker import StepParts

#: Observation, reward, termination, truncation and info.
GymnasiumStep: TypeAlias = tuple[Any, float, bool, bool, dict[str, Any]]


class _TrackNames:
    """Names of all race tracks, read on first access."""

    def __get__(self, instance: object, owner: type | None = None) -> list[str]:
        return list(find_assets().tracks)


class GymnasiumRaceEnv(RaceFront, LeftOutNames, gym.Env[Any, Any]):
    """Base class of Gymnasium environments on top of the parallel environment.

    Attributes:
        core: the :class:`~stkzoo.env.parallel.RaceParallelEnv` that runs the race.
        TRACKS: names of all race tracks.
        default_track: the requested track or tracks; ``None`` for any. You may set this and the
            following attributes, which are options of :class:`~stkzoo.env.parallel.RaceParallelEnv`
            too; the next reset applies them.
        difficulty: skill of the game's bots and speed of all karts, 0 to 3.
        laps: number of laps.
        max_paths: number of observed track segments; ``None`` for all.
        step_size: game time of one step [s].
        track: map of the current track; ``None`` before the first reset.
        num_kart: number of karts in the race.
        num_cameras: number of agents with a camera.
    """

    left_out: ClassVar = {
        **dict.fromkeys(("race_step", "reset_race", "warmup_race"), "use reset and step"),
        **dict.fromkeys(("get_state", "last_overall_distances"), "use the result of step"),
        **dict.fromkeys(("free_positions", "kart_m_indices"), "use kart_indices"),
        "path_cache": "use track.nodes_ahead(numpy.array([node]))",
    }

    metadata: dict[str, Any] = {  # noqa: RUF012 - Gymnasium's convention
        "render_modes": list(RENDER_MODES),
        "render_fps": 10,
    }
    TRACKS = _TrackNames()
    default_track = RaceOption("track")
    difficulty = RaceOption("difficulty")
    laps = RaceOption("laps")
    max_paths = RaceOption("max_paths")
    step_size = RaceOption("step_size")
    track = RaceFront.track_map

    def __init__(
        self, agents: Sequence[AgentSpec | Mapping[str, object]] | int | None, **options: Any
    ) -> None:
        # The TimeLimit of the registered ids truncates long races.
        options.setdefault("max_cycles", None)
        options["reward"] = RewardOver("reference", options.get("reward"))
        if isinstance(agents, Sequence) and not isinstance(agents, str):
            agents = specs = [AgentSpec.of(agent, f"agent {n}") for n, agent in enumerate(agents)]
            use_known_karts(specs, find_assets().karts)
        self.core = RaceParallelEnv(agents=agents, **options)
        self.live_race = self.core.live_race
        self._last_step: tuple[Snapshot | None, GymnasiumStep | None] = None, None
        self._has_warned_of_end = False
        self.num_kart = self.options.num_kart
        self.num_cameras = options.get("num_cameras", 0)
        self.render_mode = self.core.render_mode
        drawn = {key: self.core.metadata[key] for key in ("render_modes", "render_fps")}
        self.metadata = {**self.metadata, **drawn}

    @classmethod
    def initialize(
        cls,
        with_graphics: bool = False,
        use_subprocess: bool = True,
        graphics_config: Any = None,  # noqa: ARG003 - the reference's argument
    ) -> list[str]:
        """Starts the game before the first race and returns the track names.

        You never need to call it.

        Args:
            with_graphics: whether the race will be rendered.
            use_subprocess: whether the game runs in its own process.
            graphics_config: ignored; accepted for compatibility with pystk2-gymnasium.

        Raises:
            AssetError: the game's data is missing.
        """
        assets = find_assets(graphics=with_graphics)
        if use_subprocess and not with_graphics and can_fork():
            start_fork_server(assets.root)
        return list(assets.tracks)

    @property
    def _np_random(self) -> np.random.Generator:  # type: ignore[override]
        return self.np_random  # under Gymnasium's private name, which its checker reads

    @property
    def np_random_seed(self) -> int:
        """The seed of the random generator."""
        source: Any = self.np_random.bit_generator
        return int(source.seed_seq.entropy)

    @property
    def current_track(self) -> str | None:
        """Name of the current track; ``None`` before the first reset."""
        return self.race.track if self.race else None

    @property
    def world(self) -> WorldView | None:
        """Current state of the race; ``None`` before the first reset."""
        return self.world_update() if self.snapshot is not None else None

    def world_update(self, keep: bool = True) -> WorldView:  # noqa: ARG002 - as the reference
        """Returns the current state of the race.

        Args:
            keep: ignored; accepted for compatibility with pystk2-gymnasium.

        Raises:
            ApiOrderError: called before the first ``reset``.
        """
        if self.snapshot is None or self.race is None:
            raise ApiOrderError("there is no race before reset(); call reset() first")
        return WorldView(self.snapshot, self.race.kart_types)

    def __getstate__(self) -> dict[str, Any]:
        """Returns the arguments, the options of the next race and the spec."""
        return {**super().__getstate__(), "spec": self.spec}

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        self.spec = state["spec"]

    def _reset_core(self, seed: int | None, options: Mapping[str, Any] | None) -> Started:
        use_known_karts(self.core.specs, self.live_race.assets.karts)
        registered = gym.registry.get(self.spec.id) if self.spec else None
        if registered is not None:
            max_cycles = self.options.changed(options or {}).max_cycles
            warn_of_time_limit(max_cycles, registered.max_episode_steps)
        return self.core.reset(seed, options)

    @property
    def config(self) -> RaceSetup | None:
        """The engine's options for the current race; ``None`` before the first reset."""
        return episode.setup if (episode := self.live_race.episode) else None

    def get_observation(self, kart_ix: int, use_ai: bool = False) -> dict[str, Any]:
        """Returns the current observation of any kart in the ``full`` view.

        Args:
            kart_ix: index of the kart in grid order.
            use_ai: whether to add ``action``, which holds zeros unless the kart is an agent's and
                the game's AI drives it.

        Raises:
            ApiOrderError: called before the first ``reset``.
            ConfigError: there is no such kart.
        """
        episode = self.live_race.running("get_observation")
        karts = np.array([check_whole("kart_ix", kart_ix, 0, self.num_kart - 1)])
        plan = ViewPlan(kart_observation_space(use_ai))
        (observation,) = RecordsObserver(plan).observe(episode, karts)
        return dict(observation)

    def step(self, action: Any) -> GymnasiumStep:
        """Advances the race by one step; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.step`.

        After the episode's end, it returns the last values again, with reward 0, and warns once.
        """
        if self._is_over:
            return self._last_step_again()
        result = self._step(action)
        if self._is_over:
            self._last_step = self.snapshot, result
        return result

    def _step(self, action: Any) -> GymnasiumStep:
        raise NotImplementedError

    @property
    def _is_over(self) -> bool:
        """Whether a race has begun and no agent is racing any more."""
        return self.snapshot is not None and not self.core.agents

    def _last_step_again(self) -> GymnasiumStep:
        """Returns the result of the step that ended the race, without its reward.

        Raises:
            ApiOrderError: this environment has not made that step, but was restored after it.
        """
        snapshot, last_step = self._last_step
        if snapshot is not self.snapshot or last_step is None:
            raise ApiOrderError("step() after the episode's end; call reset() first")
        if not self._has_warned_of_end:
            self._has_warned_of_end = True
            warnings.warn(
                "step() after the episode's end returns the last values again, with reward 0; "
                "call reset() first",
                stacklevel=3,
            )
        observation, _, terminated, truncated, info = copy.deepcopy(last_step)
        return observation, 0.0, terminated, truncated, info


class STKRaceEnv(GymnasiumRaceEnv):
    """A race with one agent; the game drives the other karts.

    Args:
        agent: the :class:`~stkzoo.config.AgentSpec` of your kart, or a mapping of its fields.
        view: see :class:`~stkzoo.env.parallel.RaceParallelEnv`.
        **options: options of the view, such as ``state_items``, and other keyword arguments of
            :class:`~stkzoo.env.parallel.RaceParallelEnv` except ``agents``. By default,
            ``max_cycles`` is unlimited and ``reward`` is ``"reference"``.

    Attributes:
        camera: your kart's camera, for :class:`~stkzoo.wrappers.CameraObservations`.

    Raises:
        ConfigError: an argument is invalid.
        AssetError: the game's data is missing.
    """

    def __init__(
        self,
        *,
        agent: AgentSpec | Mapping[str, object] | None = None,
        view: Any = "full",
        **options: Any,
    ) -> None:
        EzPickle.__init__(self, agent=agent, view=view, **options)
        self.agent = AgentSpec() if agent is None else AgentSpec.of(agent)
        self._view, race = split_keywords(view, options, ("agent",))
        super().__init__([self.agent], view=self._view, **race)
        (self._name,) = self.core.possible_agents
        self.observation_space = self.core.observation_space(self._name)
        self.action_space = self.core.action_space(self._name)
        self.camera = self.core.cameras.by_agent[self._name]

    @property
    def kart_ix(self) -> int | None:
        """Index of your kart in grid order; ``None`` before the first reset."""
        return self.race.kart_indices[0] if self.race else None

    def get_keys_to_action(self) -> dict[Any, Any]:
        """Returns the action for each combination of keys, for :func:`gymnasium.utils.play.play`.

        The keys are those of the game: arrow keys drive, space fires, N is nitro, V drifts, and
        backspace calls the rescue bird.

        Raises:
            ConfigError: the view is custom and does not define actions for keys.
        """
        view = views_of_agents(self._view, [self._name])[self._name]
        return keys_to_action(view, repr(self._ezpickle_kwargs["view"]))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts a new race; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`."""
        observations, infos = self._reset_core(seed, options)
        return observations[self._name], infos[self._name]

    def _step(self, action: Any) -> GymnasiumStep:
        name = self._name
        observations, rewards, terminations, truncations, infos = self.core.step({name: action})
        return observations[name], rewards[name], terminations[name], truncations[name], infos[name]


def split_keywords(
    view: object, keywords: Mapping[str, Any], others: Collection[str]
) -> tuple[object, dict[str, Any]]:
    """Splits the keyword arguments of an id into options of the view and options of the race.

    Args:
        view: the view.
        keywords: options of the view and arguments of
            :class:`~stkzoo.env.parallel.RaceParallelEnv`. A keyword that both accept goes to both,
            but ``None`` goes to the race only.
        others: additional names to accept; they go to the race.

    Returns:
        The view with its options, and the remaining keyword arguments.

    Raises:
        ConfigError: neither the view nor the race has a keyword.
    """
    (bare_view,) = views_of_agents(view, ["kart_0"]).values()
    names = options_of(bare_view)
    race = {*inspect.signature(RaceParallelEnv).parameters, "num_karts", *others} - {"agents"}
    for name in keywords:
        if name not in race.union(names):
            raise unknown_argument(name, race.union(names))
    options = {
        name: keywords[name]
        for name in names
        if name in keywords and (keywords[name] is not None or name not in race)
    }
    rest = {name: value for name, value in keywords.items() if name in race}
    return (find_view((bare_view, options)) if options else view), rest


class STKRaceMultiEnv(GymnasiumRaceEnv):
    """A race with several agents, named ``"0"`` to ``"n-1"``, in the ``full`` view.

    The reward is the sum over the agents. ``info`` holds ``reward``, ``terminated``, ``done`` and
    ``infos``, each by agent. The episode ends when all agents have finished. An agent that has
    finished still gets observations, earns no reward, and its actions are ignored.

    Args:
        agents: a list of :class:`~stkzoo.config.AgentSpec` or mappings of their fields, or the
            number of agents; by default, all karts are agents.
        **options: keyword arguments of :class:`~stkzoo.env.parallel.RaceParallelEnv` except
            ``view``. By default, ``max_cycles`` is unlimited and ``reward`` is ``"reference"``.

    Raises:
        ConfigError: an argument is invalid.
        AssetError: the game's data is missing.
    """

    def __init__(
        self,
        *,
        agents: Sequence[AgentSpec | Mapping[str, object]] | int | None = None,
        **options: Any,
    ) -> None:
        EzPickle.__init__(self, agents=agents, **options)
        super().__init__(agents, **options)
        if not self.core.live_race.chains.is_compiled:
            raise ConfigError(
                "view has wrappers in Python, which cannot change the observations of agents that "
                'have finished. Put them into MonoAgentWrapperAdapter(env, {"0": ...}), or into '
                "race_v0.parallel_env(view=...)"
            )
        self.agents = self.core.specs
        self._names = {str(i): agent for i, agent in enumerate(self.core.possible_agents)}
        self.observation_space = spaces.Dict(self._by_number(self.core.observation_spaces))
        self.action_space = spaces.Dict(self._by_number(self.core.action_spaces))

    @property
    def kart_indices(self) -> list[int] | None:
        """Index of each agent's kart in grid order; ``None`` before the first reset."""
        return list(self.race.kart_indices) if self.race else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Starts a new race; see :meth:`~stkzoo.env.parallel.RaceParallelEnv.reset`."""
        with self.core.live_race.turn:
            observations, infos = self._reset_core(seed, options)
            return self._completed(observations, self.core.observe), self._info(infos, {}, {})

    def _step(self, action: Mapping[str, Any]) -> GymnasiumStep:
        with self.core.live_race.turn:
            observations, rewards, _, truncations, infos = self._step_by_number(action)
            return (
                self._completed(observations, self.core.observe),
                float(sum(rewards.values())),
                not self.core.agents and not any(truncations.values()),
                any(truncations.values()),
                self._info(infos, rewards, truncations),
            )

    def _last_step_again(self) -> GymnasiumStep:
        last_step = super()._last_step_again()
        last_step[-1]["reward"] = dict.fromkeys(self._names, 0.0)
        return last_step

    def _step_by_number(self, action: Mapping[str, Any]) -> StepParts:
        """Steps the race with actions by number; returns results by agent."""
        if isinstance(action, Mapping):
            action = {self._names.get(str(key), key): value for key, value in action.items()}
        try:
            return self.core.step(action)
        except ActionError as error:
            text = re.sub(r"'kart_(\d+)'", r"'\1'", str(error))
            raise ActionError(text, error.agent.removeprefix("kart_")) from None

    def _completed(
        self, by_agent: Mapping[str, Any], of_departed: Callable[[list[str]], dict[str, Any]]
    ) -> dict[str, Any]:
        """Returns values by number, with those of agents that have finished."""
        departed = [agent for agent in self.core.possible_agents if agent not in by_agent]
        missing = of_departed(departed) if departed else {}
        return self._by_number({**missing, **by_agent})

    def _info(
        self,
        infos: Mapping[str, dict[str, Any]],
        rewards: Mapping[str, float],
        truncations: Mapping[str, bool],
    ) -> dict[str, Any]:
        agents = self.core.possible_agents
        done = {agent: agent not in self.core.agents for agent in agents}
        terminated = {a: is_done and not truncations.get(a, False) for a, is_done in done.items()}
        return {
            "infos": self._completed(infos, self.core.infos),
            "reward": self._by_number({agent: rewards.get(agent, 0.0) for agent in agents}),
            "terminated": self._by_number(terminated),
            "done": self._by_number(done),
        }

    def _by_number(self, by_agent: Mapping[str, Any]) -> dict[str, Any]:
        return {key: by_agent[agent] for key, agent in self._names.items()}
