"""Opponents: karts that are not agents but run other drivers than the game's AI."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import chain, repeat
from types import FunctionType
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from stkzoo.config import AgentSpec
from stkzoo.drivers import Actor, Driver, DriverInstance, DriverRequest
from stkzoo.drivers.code import AgentCode
from stkzoo.drivers.failures import in_words, printable
from stkzoo.env.episode import Episode
from stkzoo.env.opponent_choice import OpponentChoice, name_of
from stkzoo.errors import ActionError, AgentError, AgentException, ConfigError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.names import CameraMode
from stkzoo.views import AgentChains, ViewFactory, full_with
from stkzoo.views.chains import ChainsMemory

logger = logging.getLogger(__name__)

Controls = npt.NDArray[np.float32]


@dataclass(slots=True)
class Opponent:
    """One opponent in one race.

    Attributes:
        request: what its driver is asked for.
        driver: its driver.
        view: its view in this race.
        code: its driver's code, if it runs in this process.
        actor: its actor, if it runs in this process.
        instance: its driver's instance, if it runs in another process.
    """

    request: DriverRequest
    driver: Driver
    view: ViewFactory
    code: AgentCode | None = None
    actor: Actor | None = None
    instance: DriverInstance | None = None

    @property
    def agent(self) -> str:
        """Id of its kart."""
        return self.request.agent

    @property
    def group(self) -> int:
        """Key of the opponents whose actions are computed together."""
        return id(self.code if self.code and self.code.act_together else self)

    def copy(self) -> Opponent:
        """Returns a copy of the opponent in its current state.

        Raises:
            AgentException: the actor's state cannot be copied.
        """
        if self.instance is not None:
            raise self._uncopied(
                "it runs in its own process; to run it in this one, use "
                f"find_driver({self.driver.source!r}, inline=True)"
            )
        parts = self.actor.args if isinstance(self.actor, partial) else (self.actor,)
        if any(isinstance(part, FunctionType) and part.__closure__ for part in parts):
            raise self._uncopied("its function is a closure; use an object with __call__ instead")
        try:
            return replace(self, actor=copy.deepcopy(self.actor))
        except Exception as error:
            raise self._uncopied(in_words(error)) from error

    def _uncopied(self, why: str) -> AgentException:
        return AgentException(
            f"opponent {name_of(self.driver)!r} of {self.agent} cannot be saved: {why}", self.agent
        )


#: State of a race's opponents at one moment: those that are still racing and that the game does not
#: drive, their observations, and the state of their wrappers.
OpponentsMoment: TypeAlias = tuple[tuple[Opponent, ...], dict[str, Any], ChainsMemory]


class RaceOpponents:
    """The opponents in the races of one environment.

    Args:
        choice: the ``opponents`` argument, also an attribute.
        num_agents: number of agents.
        count: number of opponents.
        view: view of the first agent, used for policies without a view of their own.

    Attributes:
        present: the opponents that still race and need actions from this environment, by id.
    """

    def __init__(
        self, choice: OpponentChoice, num_agents: int, count: int, view: ViewFactory
    ) -> None:
        self.choice, self._view = choice, view
        self._ids = tuple(f"kart_{num_agents + number}" for number in range(count))
        self._chains_of_views = lru_cache(16)(lambda *views: AgentChains(dict(views)))
        self.present: dict[str, Opponent] = {}
        self._observations: dict[str, Any] | None = {}  # None after a step
        self._chains = self._chains_here()

    def draw(
        self,
        random: np.random.Generator,
        difficulty: int | None,
        are_game_ai: Sequence[bool] | None = None,
    ) -> tuple[tuple[Driver, ...], int | None]:
        """Draws the drivers of a race, and returns them and the difficulty that they require.

        Args:
            random: random generator.
            difficulty: difficulty requested in ``reset``, if any.
            are_game_ai: whether each opponent of a scenario is the game's AI; ``None`` without a
                scenario.

        Raises:
            ConfigError: the opponents require another difficulty, or are not those of the scenario.
        """
        members = self.choice.members(len(self._ids))
        level = self.choice.level(difficulty)
        drawn: list[Driver] = []
        kinds = chain(are_game_ai or (), repeat(None))
        for member, is_game_ai in zip(members, kinds, strict=False):
            driver = (
                member if isinstance(member, Driver) else member.draw(random, level, is_game_ai)
            )
            drawn.append(driver)
            level = level if driver.difficulty is None else driver.difficulty
        if are_game_ai is not None and are_game_ai != [driver.is_game_ai for driver in drawn]:
            raise ConfigError(
                f"the scenario has {len(are_game_ai)} opponents, {sum(are_game_ai)} of them driven "
                "by the game; this environment has different ones; create one with the same "
                "opponents"
            )
        return tuple(drawn), level

    def specs(self, drivers: Sequence[Driver]) -> list[AgentSpec]:
        """Returns the agent specs of the drivers' karts."""
        return [
            AgentSpec(use_ai=driver.is_game_ai, name=name_of(driver), camera_mode=CameraMode.OFF)
            for driver in drivers
        ]

    def begin(self, drivers: Sequence[Driver], episode: Episode) -> None:
        """Starts the drivers of a race; a driver that fails is removed from the race.

        Args:
            drivers: one driver per opponent.
            episode: the race.

        Raises:
            ConfigError: a driver's view fails.
        """
        self.close()
        seed = episode.race.seed
        for number, (agent, driver) in enumerate(zip(self._ids, drivers, strict=True)):
            if driver.is_game_ai:
                continue
            seen = kart_observation_space(extras=driver.extras)
            request = DriverRequest(agent, seen, kart_action_space(), seed + number)
            opponent = self.present[agent] = Opponent(request, driver, full_with(driver.extras))
            self.attempt(opponent, partial(self._start, opponent))
        self._chains = self._chains_here()
        observations: dict[str, Any] = {}
        for opponent in [*self.present.values()]:
            self.attempt(opponent, partial(self._get_ready, opponent, episode, observations))
        self._observations = observations

    def moment(self, episode: Episode) -> OpponentsMoment:
        """Returns the current state of the opponents as a value.

        Raises:
            AgentException: an opponent's state cannot be copied.
        """
        seen = copy.deepcopy(self._look(episode))
        opponents = tuple(opponent.copy() for opponent in self.present.values())
        return opponents, seen, self._chains.memory()

    def go_on_from(self, moment: OpponentsMoment) -> None:
        """Continues from a :meth:`moment` of this or another environment."""
        self.close()
        opponents, observations, memory = moment
        self.present = {opponent.agent: opponent.copy() for opponent in opponents}
        self._observations = copy.deepcopy(observations)
        self._chains = self._chains_here()
        self._chains.recall(memory)

    def close(self) -> None:
        """Stops the drivers of the current race."""
        for agent in [*self.present]:
            self._remove(agent)
        self._observations = {}

    def _start(self, opponent: Opponent) -> None:
        driver = opponent.driver
        if driver.load is None:
            assert driver.start is not None  # noqa: S101 - not the game's AI
            opponent.instance = driver.start(opponent.request)
        else:
            opponent.code = self.choice.code(driver)
            opponent.view = opponent.code.wrap or self._view

    def _get_ready(
        self, opponent: Opponent, episode: Episode, observations: dict[str, Any]
    ) -> None:
        """Waits for an opponent, and adds its first observation to those of all."""
        agent, code = opponent.agent, opponent.code
        if opponent.instance is not None:
            opponent.instance.ready()
        elif code is not None:
            spaces = self._chains.observation_spaces[agent], self._chains.action_spaces[agent]
            with code.scope:
                opponent.actor = code.make_actor(*spaces, opponent.request.seed)
        seats = episode.seats((agent,))
        seen, _ = self._chains.reset(seats, episode, {agent: {}}, seed=episode.race.seed)
        observations |= seen

    def _chains_here(self) -> AgentChains:
        """Builds the opponents' views.

        Raises:
            ConfigError: a view fails, or an opponent cannot use the agents' view.
        """
        opponents = self.present.values()
        try:
            return self._chains_of_views(*((each.agent, each.view) for each in opponents))
        except (AgentException, ConfigError) as error:
            names = ", ".join(repr(name_of(each.driver)) for each in opponents)
            raise ConfigError(
                f"a view of the opponents {names} fails ({error}); give the opponent another, "
                "such as Driver.of_policy(policy, view='racing')"
            ) from error

    def attempt(self, opponent: Opponent, call: Callable[[], Any]) -> Any:
        """Calls a driver; if the call fails, removes the driver and returns ``None``."""
        try:
            return call()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - costs only its own kart
            self.retire(opponent, error)

    def retire(self, opponent: Opponent, error: BaseException) -> None:
        """Removes a failed opponent from the race; its kart rolls to a stop."""
        if opponent.agent not in self.present:
            return
        self._remove(opponent.agent)
        text = printable(in_words(error))
        who = name_of(opponent.driver)
        logger.warning("opponent %s of %s is out of the race: %s", who, opponent.agent, text)

    def _remove(self, agent: str) -> None:
        instance = self.present.pop(agent).instance
        if instance is not None:
            instance.close()

    # ------------------------------------------------------------------ a step

    def ask(self, episode: Episode) -> list[tuple[Opponent, Any]]:
        """Returns the opponents that act now, with their observations.

        Drivers in other processes start to compute their actions.
        """
        seen = self._look(episode)
        for opponent in [*self.present.values()]:
            if opponent.instance is not None:
                self.attempt(opponent, partial(opponent.instance.ask, seen[opponent.agent]))
        return [(opponent, seen[agent]) for agent, opponent in self.present.items()]

    def write(self, actions: Mapping[str, Any], episode: Episode, controls: Controls) -> None:
        """Writes the opponents' controls.

        Args:
            actions: actions by opponent; opponents without an action have failed.
            episode: the race.
            controls: controls of all player karts, ``(P, 7)`` float32; changed in place.
        """
        while True:
            seats = episode.seats(tuple(self.present))
            try:
                decoded = self._chains.convert(self._chains.check(actions, seats), episode)
                break
            except (ActionError, AgentError) as error:
                agent = error.agent if isinstance(error, ActionError) else error.key
                self.retire(self.present[agent], error)
        controls[seats.rows] = decoded[seats.rows]
        self._observations = None

    def _look(self, episode: Episode) -> dict[str, Any]:
        """Returns the current observations of the opponents that are still racing."""
        seen = self._observations
        if seen is None:
            seats = episode.seats(tuple(self.present))
            seen = self._chains.observe(seats, episode)
            infos: dict[str, dict[str, Any]] = {agent: {} for agent in seats.agents}
            no = dict.fromkeys(seats.agents, False)
            parts = seen, dict.fromkeys(seats.agents, 0.0), no, dict(no), infos
            if not self._chains.is_compiled:
                for agent in seats.agents:
                    finish = partial(self._chains.finish, episode.seats((agent,)), parts)
                    self.attempt(self.present[agent], finish)
            self._observations = seen
        finished = episode.snapshot.karts["has_finished_race"]
        if finished.any():
            seats = episode.seats(tuple(self.present))
            for agent, kart in zip(seats.agents, seats.karts.tolist(), strict=True):
                if finished[kart]:
                    self._remove(agent)
        return seen


def drive_together(races: Sequence[tuple[RaceOpponents, Episode, Controls]]) -> None:
    """Computes the actions of the opponents of several races and writes their controls.

    Out-of-process drivers compute in parallel. Karts of the same batch-capable driver share one
    call.

    Args:
        races: for each race its opponents, its episode, and the controls of its player karts, ``(P,
            7)`` float32; the controls are changed in place.
    """
    actions: list[dict[str, Any]] = [{} for _ in races]
    groups: dict[int, list[tuple[int, Opponent, Any]]] = {}
    for number, (race, episode, _) in enumerate(races):
        for opponent, seen in race.ask(episode):
            groups.setdefault(opponent.group, []).append((number, opponent, seen))
    # Drivers in other processes compute their actions meanwhile.
    for group in sorted(groups.values(), key=lambda group: group[0][1].instance is not None):
        try:
            picked = _picked([member for _, member, _ in group], [seen for *_, seen in group])
        except (Exception, SystemExit) as error:  # noqa: BLE001, PERF203 - the driver's own code
            for number, opponent, _ in group:
                races[number][0].retire(opponent, error)
        else:
            for (number, opponent, _), action in zip(group, picked, strict=True):
                actions[number][opponent.agent] = action
    for (race, episode, controls), acted in zip(races, actions, strict=True):
        race.write(acted, episode, controls)


def _picked(opponents: Sequence[Opponent], seen: Sequence[Any]) -> Sequence[Any]:
    """Returns the actions of a group of opponents."""
    code, instance = opponents[0].code, opponents[0].instance
    if instance is not None:
        return [instance.answer().action]
    assert code is not None  # noqa: S101 - it runs in this program
    actors: list[Any] = [opponent.actor for opponent in opponents]
    with code.scope:
        if code.act_together is None:
            return [actors[0](seen[0])]
        actions = code.act_together(actors, seen)
    if len(actions) != len(seen):
        raise AgentError(
            f"it returned {len(actions)} actions for {len(seen)} karts, expected one for each"
        )
    return actions
