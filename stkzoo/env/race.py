"""One race at a time, from its start to its end: what all environments drive."""

from __future__ import annotations

import contextlib
import copy
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from stkzoo.config import AgentSpec
from stkzoo.engine.assets import Assets
from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import CallTurn, Session
from stkzoo.engine.setup import RaceSetup
from stkzoo.env.episode import EndArrays, Episode
from stkzoo.env.grid import draw_race, roster_of
from stkzoo.env.options import RaceOptions, check_agents, random_stream
from stkzoo.env.rendering import RaceCameras, Rendering
from stkzoo.env.scenario import Scenario, digest_of, read_scenario
from stkzoo.env.starts import MAX_START_DRAWS, is_random
from stkzoo.env.state import Moment, RaceState, check_beside, checked_state
from stkzoo.env.vec.starts import AheadStarts, RepeatedStarts
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.kernel import split_batch
from stkzoo.mdp.rewards import Reward
from stkzoo.views.chains import AgentChains, CheckedActions
from stkzoo.views.plan import Seats
from stkzoo.views.registry import ViewFactory
from stkzoo.views.walker import StepParts

if TYPE_CHECKING:
    from stkzoo.drivers import Driver
    from stkzoo.env.opponents import RaceOpponents
    from stkzoo.env.vec.slots import SlotSteps

Controls = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]
Started = tuple[dict[str, Any], dict[str, dict[str, Any]]]


@dataclass(kw_only=True, eq=False)
class Race:
    """One race: its game, its episode, its agents' views and its other parts.

    The environments are fronts: they hold races and translate the API of a library. A race is
    reused: each :meth:`start` begins another episode.

    Attributes:
        options: options of the next race.
        specs: options of the agents.
        rewards: reward of each agent, in agent order.
        assets: the game's data.
        new_session: makes a session in which a game can run.
        views: view of each agent.
        rendering: renders the race.
        opponents: drivers of karts that are not agents, if there are any.
        num_cameras: number of agents with a camera; 0 leaves the choice to the agents.
        possible_agents: ids of all agents.
        ai_agents: agents that the game's AI drives.
        cameras: the agents' cameras.
        chains: observations and actions of all agents in their views.
        agents: agents that are still racing.
        episode: the current episode; ``None`` before the first start.
        np_random: the random generator from which races are drawn.
        turn: the turn that a thread holds during a call; the fronts take it.
        session: the session of the current game.
        starts: begins the game's races.
        is_copy: whether the environment is a copy, which never has the race of its original.
    """

    options: RaceOptions
    specs: Sequence[AgentSpec]
    rewards: Mapping[str, Reward]
    assets: Assets
    new_session: Callable[[], Session]
    views: Mapping[str, ViewFactory]
    rendering: Rendering
    opponents: RaceOpponents | None
    num_cameras: int

    def __post_init__(self) -> None:
        self.possible_agents = [*self.rewards]
        self.ai_agents = self._agents_of_ai()
        self.cameras = RaceCameras(self.possible_agents, weakref.proxy(self))
        self.chains = AgentChains(self.views, self.ai_agents, self.cameras.by_agent)
        self.agents: list[str] = []
        self.episode: Episode | None = None
        self.np_random = random_stream(None)
        self.turn, self.is_copy = CallTurn(), False
        self.session = self.new_session()
        self.starts: AheadStarts | RepeatedStarts = AheadStarts(self.new_session)
        self._stepping: Episode | None = None  # the episode with a running step

    def running(self, method: str) -> Episode:
        """Returns the current episode.

        Args:
            method: name of the user's call, for the message.

        Raises:
            ApiOrderError: no race has started.
        """
        if self.episode is None:
            why = "; a copy starts without a race, only clone() keeps it" if self.is_copy else ""
            raise ApiOrderError(f"{method}() before reset(); call reset() first{why}")
        return self.episode

    # ------------------------------------------------------------------ start and end

    def start(self, seed: int | None, asked: Mapping[str, Any]) -> Started:
        """Starts an episode and returns its first observations and infos by agent.

        Args:
            seed: seed of the wrappers. The race itself is drawn from :attr:`np_random`.
            asked: options of ``reset``.

        Raises:
            ConfigError: an option is invalid, or there is no display for ``"human"``.
            EngineError: the game does not start.
        """
        self.rendering.check()
        options = self.options.of_episode(asked, self.assets.tracks)
        check_agents(self.specs, self.options.num_kart, self.assets.karts)
        if self._agents_of_ai() != self.ai_agents:
            raise ConfigError(
                "use_ai of an agent was changed after the environment was made, which would "
                "change its spaces; make a new environment"
            )
        with self.exchange():
            moment = self._asked_moment(asked)
            agents = self.possible_agents
            if moment is not None:
                agents = [agent for agent in agents if agent in moment.agents]
            if isinstance(moment, RaceState):
                self.episode = self._from_state(moment, options)
            else:
                self.episode = self._begun(moment, options, asked)
            self.agents, self._stepping = [], None  # in case a wrapper fails
        seats = self.episode.seats(agents)
        infos = self.episode.infos(seats)
        result = self.chains.reset(seats, self.episode, infos, seed=seed, options=dict(asked))
        self.agents = list(agents)
        self.rendering.reset(self.episode)
        return result

    def check_options(self, asked: Mapping[str, Any]) -> None:
        """Checks options of :meth:`start`.

        Raises:
            ApiOrderError: no agent was racing any more at the moment of a state or scenario.
            ConfigError: an option is unknown or invalid.
        """
        options = self.options.of_episode(asked, self.assets.tracks)
        moment = self._asked_moment(asked)
        if isinstance(moment, Scenario):
            self._draw_opponents(options, asked, copy.deepcopy(self.np_random), moment)
        elif moment is None and self.opponents is not None:
            self.opponents.choice.level(asked.get("difficulty"))

    def next_setup(self, seed: int | None, asked: Mapping[str, Any]) -> RaceSetup | None:
        """Returns the setup of the race that :meth:`start` will draw, without drawing it.

        Args:
            seed: seed of the random generator; ``None`` for its current state.
            asked: options of the race.

        Returns:
            The setup; ``None`` if the race starts from a state or a scenario.
        """
        if not asked.keys().isdisjoint(("state", "scenario")):
            return None
        random = copy.deepcopy(self.np_random) if seed is None else random_stream(seed)
        options, _, specs = self._draw_opponents(self.options.changed(asked), asked, random)
        return self._draw(options, specs, random)[0]

    def close(self) -> None:
        """Stops the game and all other processes. :meth:`start` works afterwards."""
        self._end()
        self.session.close()
        self.starts.close()
        self.rendering.close()
        self.cameras.close()
        self.chains.close()

    @contextlib.contextmanager
    def exchange(self) -> Iterator[None]:
        """Ends the race if the game continues elsewhere but the rest of the race does not.

        An error or Ctrl-C can end the body after the game's process was replaced. The game and
        the race would then be at different moments, so only another start can continue.
        """
        before = self.session.pid
        try:
            yield
        except BaseException:
            if self.session.pid != before:
                self._end()
            raise

    # ------------------------------------------------------------------ a step

    def request(self, actions: Mapping[str, Any]) -> None:
        """First half of a step: decodes the actions and sends the controls to the game.

        Raises:
            ActionError: an action is missing or invalid; the race has not advanced.
            ApiOrderError: no race has started, or a step is running.
            EngineError: the game crashed or hung.
        """
        episode = self._resting("step")
        checked = self.chains.check(actions, episode.seats(self.agents))
        controls = self.chains.convert(checked, episode)
        if self.opponents is not None:
            drive_opponents([self], [controls])
        self.send(controls)

    def finish(self) -> StepParts:
        """Second half of a step: waits for the game and makes the results by agent.

        Raises:
            AgentException: a wrapper failed.
            ApiOrderError: no step is running.
            EngineError: the game crashed or hung.
        """
        episode, agents = self._awaited(), self.agents
        if not agents:
            self._stepping = None
            return {}, {}, {}, {}, {}
        seats = episode.seats(agents)
        self._advance(episode, seats, seats.order, episode.ends)
        rewards, terminations, truncations = episode.ends
        parts = (
            self.chains.observe(seats, episode),
            split_batch(rewards, seats.agents),
            split_batch(terminations, seats.agents),
            split_batch(truncations, seats.agents),
            episode.infos(seats),
        )
        self.chains.finish(seats, parts)
        _, _, terminated, truncated, _ = parts
        if any(terminated.values()) or any(truncated.values()):
            self.agents = [a for a in agents if not (terminated[a] or truncated[a])]
        if self.rendering.mode is not None:
            self.rendering.follow(episode)
        return parts

    def finish_into(self, steps: SlotSteps, slots: IntArray) -> IntArray:
        """Does the same as :meth:`finish` with rows of arrays, if :attr:`chains` have rows.

        Args:
            steps: steps of all slots. Gets rewards and ends of the agents that acted, and
                observations and infos of those that are still racing.
            slots: slot of each agent that acted.

        Returns:
            Slots of the agents that are still racing.
        """
        episode = self._awaited()
        self._advance(episode, episode.seats(self.agents), slots, steps.ends)
        has_ended = steps.terminations[slots] | steps.truncations[slots]
        if has_ended.any():
            ended = zip(self.agents, has_ended.tolist(), strict=True)
            self.agents = [agent for agent, is_over in ended if not is_over]
            slots = slots[~has_ended]
        if self.agents:
            seats = episode.seats(self.agents)
            self.chains.observe_into(seats, episode, slots, steps.observations)
            table = steps.infos.table(episode.info_keys)
            episode.infos_into(seats, slots, table)
            table.has[slots] = True
        return slots

    def check(self, actions: Mapping[str, Any]) -> CheckedActions:
        """Checks actions and changes nothing; :meth:`convert` converts them to controls.

        Raises:
            ActionError: an action is missing or invalid.
            ApiOrderError: no race has started, or a step is running.
        """
        return self.chains.check(actions, self._resting("step").seats(self.agents))

    def check_rows(self, actions: Any, slots: IntArray, count: int) -> CheckedActions | None:
        """Does the same as :meth:`check` for a batch of actions.

        Args:
            actions: an array with one row per slot, or a dict of such arrays.
            slots: slot of each racing agent.
            count: number of slots in the batch.

        Returns:
            The actions; ``None`` if one is invalid or in an unusual form, or a wrapper runs in
                Python.
        """
        seats = self._resting("step").seats(self.agents)
        return self.chains.check_batch(actions, slots, count, seats)

    def convert(self, actions: CheckedActions) -> Controls:
        """Converts checked actions to controls, ``(P, 7)`` float32.

        Raises:
            ActionError: a wrapper returned an invalid action.
            AgentException: a wrapper failed.
        """
        return self.chains.convert(actions, self._resting("step"))

    def send(self, controls: Controls) -> None:
        """Starts a step in the game.

        Args:
            controls: controls of the P player karts, ``(P, 7)`` float32.
        """
        episode = self.running("step")
        if self.agents:
            self.session.step_async(controls)
            episode.remember(controls)
        self._stepping = episode

    def observe(self, agents: Sequence[str]) -> dict[str, Any]:
        """Returns current observations of some agents, before their Python wrappers."""
        episode = self.running("observe")
        return self.chains.observe(episode.seats(agents), episode)

    def infos(self, agents: Sequence[str]) -> dict[str, dict[str, Any]]:
        """Returns current infos of some agents, before their Python wrappers."""
        episode = self.running("infos")
        return episode.infos(episode.seats(agents))

    # ------------------------------------------------------------------ moments

    def save(self) -> RaceState:
        """Saves the current moment of the race, which continues unaffected."""
        self.running("save_state")
        moment = self._moment()
        return RaceState(self.session.branch(), moment)

    def restore(self, state: RaceState) -> None:
        """Continues from a saved state, with everything as it was at that moment."""
        self._check_moment(checked_state(state).moment)
        with self.exchange():
            state.resume_in(self.session)
            self._go_on_from(state.moment)

    def follow(self, other: Race) -> None:
        """Continues from the current moment of another race, like a clone of it."""
        other.running("clone")
        moment = other._moment()
        self._check_moment(moment)
        with self.exchange():
            self.session.resume(other.session)
            self.options = other.options
            self._go_on_from(moment)

    def scenario(self) -> Scenario:
        """Returns the current moment as a scenario."""
        episode = self._resting("scenario")
        return Scenario(
            setup=episode.setup,
            kart_indices=episode.race.kart_indices,
            agents=tuple(self.agents),
            controls=episode.past_controls(),
            digest=digest_of(episode.snapshot),
            opponents=episode.race.opponent_indices,
        )

    def _moment(self) -> Moment:
        episode = self._resting("save_state").copy()
        return Moment(
            episode,
            tuple(self.agents),
            self._roster(),
            copy.deepcopy(self.np_random),
            self.chains.memory(),
            None if self.opponents is None else self.opponents.moment(episode),
        )

    def _check_moment(self, moment: Moment) -> None:
        self._check_roster("state", moment.roster)
        self.chains.check_memory(moment.memory)

    def _go_on_from(self, moment: Moment) -> None:
        self._stepping = None
        self.chains.recall(moment.memory)
        self.episode = moment.episode.copy()
        self.agents = list(moment.agents)
        self.np_random = copy.deepcopy(moment.random)
        self._go_on_with_opponents(moment)

    def _go_on_with_opponents(self, moment: Moment) -> None:
        if self.opponents is not None and moment.opponents is not None:
            self.opponents.go_on_from(moment.opponents)

    def _roster(self) -> str:
        num_kart, num_agents = self.options.num_kart, len(self.possible_agents)
        return roster_of(num_kart, num_agents, self.ai_agents, self.opponents is not None)

    def _check_roster(self, what: str, roster: str) -> None:
        if roster != self._roster():
            raise ConfigError(
                f"the {what} has {roster}, but this environment has {self._roster()}; use an "
                "environment with the same karts, agents and opponents"
            )

    # ------------------------------------------------------------------ beginnings of an episode

    def _from_state(self, state: RaceState, options: RaceOptions) -> Episode:
        """Starts an episode at a saved moment."""
        state.resume_in(self.session)
        self._go_on_with_opponents(state.moment)
        return state.moment.episode.restarted(options, self.rewards)

    def _begun(
        self, scenario: Scenario | None, options: RaceOptions, asked: Mapping[str, Any]
    ) -> Episode:
        """Draws a race and starts it, or drives one to the moment of a scenario."""
        random = self.np_random
        options, drivers, specs = self._draw_opponents(options, asked, random, scenario)
        self._end()  # in case the start fails
        if scenario is None:
            setup, kart_indices, begun = self._start_drawn(options, specs, random)
        else:
            begun = scenario.reach(self.session)
            setup = scenario.setup_with([spec.name for spec in specs])
            kart_indices = (*scenario.kart_indices, *scenario.opponents)
        root = self.assets.root
        episode = Episode(options, setup, kart_indices, begun, self.rewards, root)
        if self.opponents is not None:
            self.opponents.begin(drivers, episode)
        for row in () if scenario is None else scenario.controls:
            episode.remember(row)
        return episode

    def _start_drawn(
        self, options: RaceOptions, opponents: Sequence[AgentSpec], random: np.random.Generator
    ) -> tuple[RaceSetup, tuple[int, ...], RaceStart]:
        """Draws races until one starts; returns its setup, its kart indices and its start."""
        for draws_left in reversed(range(MAX_START_DRAWS)):
            setup, kart_indices = self._draw(options, opponents, random)
            try:
                self.session, begun = self.starts.begin(setup, self.session)
                break
            except ConfigError:  # a place where no kart can stand
                if not draws_left or not is_random(options.start):
                    raise
        return setup, kart_indices, begun

    def _draw(
        self, options: RaceOptions, opponents: Sequence[AgentSpec], random: np.random.Generator
    ) -> tuple[RaceSetup, tuple[int, ...]]:
        tracks = options.tracks(self.assets.tracks)
        has_window = self.rendering.mode == "human"
        cameras = self.num_cameras
        return draw_race(options, self.specs, tracks, cameras, has_window, random, opponents)

    def _draw_opponents(
        self,
        options: RaceOptions,
        asked: Mapping[str, Any],
        random: np.random.Generator,
        scenario: Scenario | None = None,
    ) -> tuple[RaceOptions, tuple[Driver, ...], list[AgentSpec]]:
        """Draws the opponents; returns the race's options, the drivers and their specs."""
        if self.opponents is None:
            return options, (), []
        difficulty, bots = asked.get("difficulty"), None
        if scenario is not None:
            difficulty = scenario.setup.difficulty
            bots = [scenario.setup.karts[kart].is_bot for kart in scenario.opponents]
        drivers, level = self.opponents.draw(random, difficulty, bots)
        options = options if level is None else replace(options, difficulty=level)
        return options, drivers, self.opponents.specs(drivers)

    def _asked_moment(self, asked: Mapping[str, Any]) -> RaceState | Scenario | None:
        """Returns the saved state or scenario at which an episode is to start, if any."""
        moment: RaceState | Scenario
        if asked.get("scenario") is not None:
            what, moment = "scenario", read_scenario(asked["scenario"])
            if moment.setup.track not in self.assets.tracks:
                raise ConfigError(
                    f"the scenario's track {moment.setup.track!r} is not here; `stkzoo assets "
                    "status` shows where the game's data comes from"
                )
        elif asked.get("state") is not None:
            what, moment = "state", checked_state(asked["state"])
        else:
            return None
        self._check_roster(what, moment.roster)
        check_beside(what, asked, moment.agents)
        return moment

    def _agents_of_ai(self) -> set[str]:
        pairs = zip(self.possible_agents, self.specs, strict=True)
        return {agent for agent, spec in pairs if spec.use_ai}

    # ------------------------------------------------------------------ the order of calls

    def _end(self) -> None:
        """Forgets the current race until another one starts."""
        self.agents = []
        self.episode = self._stepping = None
        if self.opponents is not None:
            self.opponents.close()

    def _advance(self, episode: Episode, seats: Seats, slots: IntArray, ends: EndArrays) -> None:
        """Waits for the game, and computes the rewards and ends of the agents that acted."""
        try:  # until the episode has advanced, signal handlers cannot save or copy the race
            episode.advance(self.session.step_wait(), seats, slots, ends)
        finally:
            self._stepping = None

    def _awaited(self) -> Episode:
        """Returns the episode that is stepping."""
        if self._stepping is None:
            raise ApiOrderError("step_wait() without step_async(); call step_async() first")
        return self._stepping

    def _resting(self, method: str) -> Episode:
        """Returns the current episode; raises if a step is running."""
        if self._stepping is not None:
            raise ApiOrderError("a step is under way; call step_wait() first")
        return self.running(method)


def drive_opponents(races: Sequence[Race], controls: Sequence[Controls]) -> None:
    """Adds the opponents' controls to those of the agents.

    Karts of the same driver are computed together, also across races.

    Args:
        races: the races that are about to step.
        controls: controls of each race, ``(P, 7)`` float32; changed in place.
    """
    driven = [
        (race.opponents, race.running("step"), players)
        for race, players in zip(races, controls, strict=True)
        if race.opponents is not None and race.opponents.present and race.agents
    ]
    if driven:
        from stkzoo.env.opponents import drive_together

        drive_together(driven)
