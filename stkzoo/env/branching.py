"""Saving, restoring and cloning the current moment of an environment's race."""

from __future__ import annotations

import contextlib
import copy
import os
import weakref
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.utils import EzPickle, seeding

from stkzoo._turns import CallTurn
from stkzoo.engine.assets import Assets
from stkzoo.engine.ground import Ground
from stkzoo.engine.session import Session
from stkzoo.engine.snapshot import Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.env.episode import Episode
from stkzoo.env.grid import RaceInfo, RaceRoster
from stkzoo.env.options import OF_AN_EPISODE, RaceOptions
from stkzoo.env.rendering import scene_of
from stkzoo.env.scenario import Scenario, digest_of
from stkzoo.env.state import Moment, RaceState
from stkzoo.errors import ApiOrderError, ConfigError, check_whole
from stkzoo.mdp.rewards import Reward
from stkzoo.render.scene import Scene
from stkzoo.views.chains import AgentChains

if TYPE_CHECKING:
    from typing_extensions import Self

    from stkzoo.drivers import Driver
    from stkzoo.env.opponents import RaceOpponents


class ClonableEnv(EzPickle):
    """An environment that can continue from the state of another environment of its class."""

    if TYPE_CHECKING:
        options: RaceOptions

        def close(self) -> None:
            """Stops the game process."""

    def __getstate__(self) -> dict[str, Any]:
        """Returns the arguments and the options of the next race."""
        return {**super().__getstate__(), "options": self.options}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Makes the environment in place, because its cameras refer to it."""
        self.__init__(*state["_ezpickle_args"], **state["_ezpickle_kwargs"])  # type: ignore[misc]
        self.options = state["options"]

    def follow(self, other: Self) -> None:
        """Continues from the current state of another environment, like a clone of it.

        Args:
            other: an environment of the same class with equal karts and agents.

        Raises:
            ApiOrderError: the other environment was not reset yet.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        raise NotImplementedError

    def clone(self) -> Self:
        """Returns an independent environment that continues from this moment.

        Raises:
            ApiOrderError: called before the first ``reset``.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        make: Any = type(self)
        twin: Self = make(*self._ezpickle_args, **self._ezpickle_kwargs)
        twin.follow(self)
        return twin

    @contextlib.contextmanager
    def lookahead(self) -> Iterator[Self]:
        """Yields a clone for trying actions and closes it at the end.

        Raises:
            ApiOrderError: called before the first ``reset``.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        branch = self.clone()
        try:
            yield branch
        finally:
            branch.close()


class BranchingRace(ClonableEnv):
    """Base class of ``RaceParallelEnv`` that saves, restores and clones its state.

    Args:
        max_snapshots: maximum number of open saved states.
    """

    # RaceParallelEnv sets these.
    possible_agents: list[str]
    _assets: Assets
    _session: Session
    _chains: AgentChains
    _rewards: Mapping[str, Reward]
    _ai_agents: set[str]
    _opponents: RaceOpponents | None

    if TYPE_CHECKING:

        def _running(self, method: str) -> Episode: ...

    def __init__(self, max_snapshots: int) -> None:
        self._turn = CallTurn()
        self._max_snapshots = check_whole("max_snapshots", max_snapshots, 0)
        self._states: weakref.WeakSet[RaceState] = weakref.WeakSet()
        self._np_random: np.random.Generator | None = None
        self._end_race()

    @property
    def race(self) -> RaceInfo | None:
        """Names of the current race and its karts; ``None`` before the first reset."""
        return self._episode.race if self._episode else None

    @property
    def scene(self) -> Scene | None:
        """Data of the current race for rendering; ``None`` before the first reset."""
        return scene_of(self._episode) if self._episode else None

    @property
    def track_map(self) -> TrackMap | None:
        """Map of the current track; ``None`` before the first reset."""
        return self._episode.track_map if self._episode else None

    @property
    def ground(self) -> Ground | None:
        """Ground and walls of the current track; ``None`` before the first reset.

        They are read from the track's meshes, which takes 0.2 to 2 s the first time.
        """
        return self._episode.ground if self._episode else None

    @property
    def snapshot(self) -> Snapshot | None:
        """Snapshot of all karts at the current moment; ``None`` before the first reset."""
        return self._episode.snapshot if self._episode else None

    @property
    def np_random(self) -> np.random.Generator:
        """The environment's random generator, which ``reset(seed=...)`` seeds."""
        if self._np_random is None:
            self._np_random, _ = seeding.np_random()
        return self._np_random

    @np_random.setter
    def np_random(self, random: np.random.Generator) -> None:
        self._np_random = random

    def save_state(self) -> RaceState:
        """Saves the current moment of the race, which continues unaffected.

        Raises:
            ApiOrderError: called before the first ``reset``, or with ``max_snapshots`` states open.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        self._running("save_state")
        if self.num_snapshots >= self._max_snapshots:
            raise ApiOrderError(
                f"{self.num_snapshots} saved states of this environment are open, as many as "
                "max_snapshots allows; close() some or raise max_snapshots"
            )
        with self._turn.of("save_state"):
            moment = self._moment()
            state = RaceState(self._session.branch(), moment)
            self._states.add(state)
            return state

    def scenario(self) -> Scenario:
        """Returns the current moment as a scenario, which can be saved and replayed elsewhere.

        Raises:
            ApiOrderError: called before the first ``reset``, or while a step is running.
        """
        if self._stepping is not None:
            raise ApiOrderError("a step is under way; call step_wait() first")
        episode = self._running("scenario")
        return Scenario(
            setup=episode.setup,
            kart_indices=episode.race.kart_indices,
            agents=tuple(self.agents),
            controls=episode.past_controls(),
            digest=digest_of(episode.snapshot),
            opponents=episode.race.opponent_indices,
        )

    def restore_state(self, state: RaceState) -> None:
        """Continues from a saved state, with everything as it was at that moment.

        This includes the counters of the episode, the reward of the environment that saved the
        state, the state of wrappers, and the random generator, so later resets repeat too. The race
        that was running in this environment ends.

        Args:
            state: a state of this environment, or of another one with the same karts and agents.

        Raises:
            ApiOrderError: the state was closed.
            ConfigError: the state belongs to an environment with other karts or agents.
            EngineError: this platform cannot fork races, or the state's process has ended; this
                environment's race continues.
        """
        with self._turn.of("restore_state"):
            self._check_moment(_checked_state(state).moment)
            with self._exchange():
                state.resume_in(self._session)
                self._go_on_from(state.moment)

    def follow(self, other: Self) -> None:
        """Continues from the current state of another environment, like a clone of it.

        Args:
            other: an environment with the same karts and agents.

        Raises:
            ApiOrderError: the other environment was not reset yet.
            ConfigError: the other environment has other karts or agents.
            AgentException: an agent's wrapper holds an object that cannot be copied.
            EngineError: this platform cannot fork races, or the game crashed.
        """
        with self._turn.of("follow"), other._turn.of("clone"):
            other._running("clone")
            moment = other._moment()
            self._check_moment(moment)
            with self._exchange():
                self._session.resume(other._session)
                self.options = other.options
                self._go_on_from(moment)

    @property
    def num_snapshots(self) -> int:
        """Number of open states that this environment saved."""
        return sum(state.is_open for state in self._states)

    def _end_race(self) -> None:
        """Forgets the current race until another one starts."""
        self.agents: list[str] = []
        self._episode: Episode | None = None
        self._stepping: Episode | None = None  # the episode with a running step
        if self._opponents is not None:
            self._opponents.close()

    @contextlib.contextmanager
    def _exchange(self) -> Iterator[None]:
        """Ends the race if the game continues elsewhere but the rest of the environment does not.

        An error or Ctrl-C can end the body after the game's process was replaced. The game and
        the environment would then be at different moments, so only ``reset`` can continue.
        """
        before = self._session.pid
        try:
            yield
        except BaseException:
            if self._session.pid != before:
                self._end_race()
            raise

    def _from_state(
        self, state: object, options: Mapping[str, Any], options_now: RaceOptions
    ) -> tuple[list[str], Episode]:
        """Returns the agents and the episode of a reset from a saved state."""
        kept = self._checked_first_state(state, options)
        moment = kept.moment
        kept.resume_in(self._session)
        if self._opponents is not None and moment.opponents is not None:
            self._opponents.go_on_from(moment.opponents)
        return list(moment.agents), moment.episode.restarted(options_now, self._rewards)

    def _from_scenario(
        self, scenario: object, options: Mapping[str, Any], options_now: RaceOptions
    ) -> tuple[list[str], Episode]:
        """Returns the agents and the episode of a reset from a scenario or its file."""
        scenario = self._checked_scenario(scenario, options)
        drivers = self._drivers_in(scenario, self.np_random)
        self._end_race()  # in case the start fails
        begun = scenario.reach(self._session)
        specs = [] if self._opponents is None else self._opponents.specs(drivers)
        setup = scenario.setup_with([spec.name for spec in specs])
        kart_indices = (*scenario.kart_indices, *scenario.opponents)
        root = self._assets.root
        episode = Episode(options_now, setup, kart_indices, begun, self._rewards, root)
        for row in scenario.controls:
            episode.remember(row)
        if self._opponents is not None:
            self._opponents.begin(drivers, episode)
        return [agent for agent in self.possible_agents if agent in scenario.agents], episode

    def _checked_first_state(self, state: object, options: Mapping[str, Any]) -> RaceState:
        """Returns a state with which an episode can start."""
        kept = _checked_state(state)
        self._check_roster("state", kept.moment.roster)
        _check_beside("state", options)
        if not kept.moment.agents:
            raise ApiOrderError(
                "the state was saved after all agents had left, so no agent can act; use an "
                "earlier state"
            )
        self._check_opponents(kept.moment.opponents is not None)
        return kept

    def _checked_scenario(self, scenario: object, options: Mapping[str, Any]) -> Scenario:
        """Returns a scenario, or that of a file, with which an episode can start."""
        _check_beside("scenario", options)
        if isinstance(scenario, (str, os.PathLike)):
            scenario = Scenario.load(scenario)
        if not isinstance(scenario, Scenario):
            raise ConfigError(
                f"scenario is {scenario!r}, expected a Scenario or the path of its file"
            )
        self._check_roster("scenario", scenario.roster)
        if not scenario.agents:
            raise ApiOrderError(
                "the scenario was saved after all agents had left, so no agent can act; use an "
                "earlier scenario"
            )
        self._check_opponents(bool(scenario.opponents))
        if scenario.setup.track not in self._assets.tracks:
            raise ConfigError(
                f"the scenario's track {scenario.setup.track!r} is not here; `stkzoo assets "
                "status` shows where the game's data comes from"
            )
        return scenario

    def _drivers_in(self, scenario: Scenario, random: np.random.Generator) -> tuple[Driver, ...]:
        """Draws the drivers of a scenario's opponents, which start at its moment."""
        if self._opponents is None:
            return ()
        bots = [scenario.setup.karts[kart].is_bot for kart in scenario.opponents]
        drivers, _ = self._opponents.draw(random, scenario.setup.difficulty, bots)
        if bots != [driver.is_game_ai for driver in drivers]:
            raise ConfigError(
                f"the scenario has {len(bots)} opponents, {sum(bots)} of them driven by the game; "
                "this environment has different ones; create one with the same opponents"
            )
        return drivers

    def _check_opponents(self, has_opponents: bool) -> None:
        if has_opponents != (self._opponents is not None):
            raise ConfigError(
                f"the saved race has {'' if has_opponents else 'no '}opponents, unlike this "
                "environment's races; create an environment with the same opponents"
            )

    def _roster(self) -> RaceRoster:
        ai_agents = frozenset(self._ai_agents)
        return RaceRoster(self.options.num_kart, len(self.possible_agents), ai_agents)

    def _check_roster(self, what: str, roster: RaceRoster) -> None:
        if roster != self._roster():
            raise ConfigError(
                f"the {what} has {roster}, but this environment has {self._roster()}; use an "
                "environment with the same karts and agents"
            )

    def _moment(self) -> Moment:
        if self._stepping is not None:
            raise ApiOrderError("a step is under way; call step_wait() first")
        episode = self._running("save_state").copy()
        random = copy.deepcopy(self.np_random)
        memory = self._chains.memory()
        opponents = None if self._opponents is None else self._opponents.moment(episode)
        return Moment(episode, tuple(self.agents), self._roster(), random, memory, opponents)

    def _check_moment(self, moment: Moment) -> None:
        self._check_roster("state", moment.roster)
        self._check_opponents(moment.opponents is not None)
        self._chains.check_memory(moment.memory)

    def _go_on_from(self, moment: Moment) -> None:
        self._stepping = None
        self._chains.recall(moment.memory)
        self._episode = moment.episode.copy()
        self.agents = list(moment.agents)
        self._np_random = copy.deepcopy(moment.random)
        if self._opponents is not None and moment.opponents is not None:
            self._opponents.go_on_from(moment.opponents)


def _checked_state(state: object) -> RaceState:
    if not isinstance(state, RaceState):
        raise ConfigError(f"state is {state!r}, expected a RaceState from save_state()")
    return state


def _check_beside(what: str, options: Mapping[str, Any]) -> None:
    """Rejects reset options that the saved state or scenario already determines."""
    own = {what, "num_kart", *OF_AN_EPISODE}
    both = ({*RaceOptions.__dataclass_fields__, "state"} - own) & set(options)
    if both:
        raise ConfigError(
            f"options have a {what} and {', '.join(sorted(both))}, which the {what} already "
            "determines; leave out one of them"
        )
