"""Karts of a race that are no agents, but driven by drivers of any kind."""

from __future__ import annotations

import copy
import logging
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath
from types import FunctionType
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.config import AgentSpec
from stkzoo.drivers import (
    Actor,
    Driver,
    DriverInstance,
    DriverRequest,
    OpponentPool,
)
from stkzoo.drivers.code import AgentCode
from stkzoo.drivers.failures import in_words, printable
from stkzoo.drivers.pool import as_driver
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.env.episode import Episode
from stkzoo.errors import ActionError, AgentError, AgentException, ConfigError, shortened
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.names import CameraMode
from stkzoo.views import AgentChains, ViewFactory, base_space, full_with
from stkzoo.views.chains import ChainsMemory

logger = logging.getLogger(__name__)

Controls = npt.NDArray[np.float32]

#: The drivers of a race's opponents, and the difficulty that they ask for, if any.
Lineup = tuple[tuple[Driver, ...], int | None]


class OpponentChoice:
    """What was asked for as opponents, and the code of those that run in this program.

    Races side by side share one, so that their karts are driven together.

    Args:
        choice: a pool, from which every kart that is no agent's draws; or a list with one
            entry for each opponent: a pool, or what :func:`~stkzoo.drivers.pool.as_driver` takes.
            A mapping is a pool of the drivers that it names, by their weights.

    Raises:
        ConfigError: it is neither, or opponents ask for different difficulties.
    """

    def __init__(self, choice: object) -> None:
        choice = OpponentPool(choice) if isinstance(choice, Mapping) else choice
        if isinstance(choice, str) or not isinstance(choice, (Sequence, OpponentPool)):
            raise ConfigError(
                f"opponents is {shortened(choice, 200)}, expected a list such as "
                "['pretrained:ace', 'ai:3'], or an OpponentPool"
            )
        self._pool = choice if isinstance(choice, OpponentPool) else None
        members = [] if isinstance(choice, OpponentPool) else list(choice)
        keys = [member if isinstance(member, str) else id(member) for member in members]
        found = {key: _driver_or_pool(m) for key, m in zip(keys, members, strict=True)}
        self._members = [found[key] for key in keys]  # equal ones drive together
        self._codes: dict[Driver, AgentCode | AgentError] = {}
        self._level(m for m in self._members if isinstance(m, Driver))
        self._resources = ExitStack()
        weakref.finalize(self, self._resources.close)

    @classmethod
    def of(cls, choice: object) -> OpponentChoice:
        """The choice of an argument, which may be a choice already."""
        return choice if isinstance(choice, cls) else cls(choice)

    def count(self, num_agents: int | None, num_kart: int) -> int:
        """How many opponents there are.

        Args:
            num_agents: the number of agents; ``None`` if all other karts are agents.
            num_kart: the number of karts.

        Raises:
            ConfigError: they do not fit.
        """
        if self._pool is None:
            count = len(self._members)
        elif num_agents is None:
            raise ConfigError(
                "a pool drives all karts that are no agents; say how many agents there are, such "
                "as agents=1, or give a list such as opponents=[pool]"
            )
        else:
            count = num_kart - num_agents
        if (1 if num_agents is None else num_agents) + count > num_kart:
            agents = "an agent" if num_agents in (None, 1) else f"{num_agents} agents"
            raise ConfigError(
                f"{agents} and {count} opponents for {num_kart} karts; raise num_kart or leave "
                "some out"
            )
        return count

    def draw(self, count: int, random: np.random.Generator, difficulty: int | None) -> Lineup:
        """The opponents of a race.

        Args:
            count: how many.
            random: draws them.
            difficulty: the race's, if it was asked for in ``reset``.

        Raises:
            ConfigError: opponents ask for another difficulty.
        """
        members = self._members if self._pool is None else [self._pool] * count
        level = self._level((m for m in members if isinstance(m, Driver)), difficulty)
        drawn: list[Driver] = []
        for member in members:
            drawn.append(member if isinstance(member, Driver) else member.draw(random, level))
            level = level if drawn[-1].difficulty is None else drawn[-1].difficulty
        return tuple(drawn), level

    def _level(self, drivers: Iterable[Driver], difficulty: int | None = None) -> int | None:
        """The one difficulty that is asked for, if any."""
        asked = [driver.difficulty for driver in drivers if driver.difficulty is not None]
        levels = {*asked, *(() if difficulty is None else (difficulty,))}
        if len(levels) > 1:
            raise ConfigError(
                f"opponents and options ask for the difficulties {sorted(levels)}, but the game's "
                "AI has one level per race; choose one"
            )
        return levels.pop() if levels else None

    def code(self, driver: Driver) -> AgentCode:
        """The code of a driver that runs in this program.

        Raises:
            AgentError: it cannot be loaded.
        """
        if driver not in self._codes:
            assert driver.load is not None  # noqa: S101 - callers look
            try:
                self._codes[driver] = driver.load(self._resources)
            except Exception as error:  # noqa: BLE001 - the driver's own code
                self._codes[driver] = AgentError(in_words(error))
        found = self._codes[driver]
        if isinstance(found, AgentError):
            raise found
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._members if self._pool is None else self._pool,)


def _driver_or_pool(member: object) -> Driver | OpponentPool:
    if isinstance(member, Mapping):
        return OpponentPool(member)
    return member if isinstance(member, OpponentPool) else as_driver(member)


def name_of(driver: Driver) -> str:
    """The name of a driver that has not been loaded."""
    source = PurePath(driver.source)
    return driver.name or (source.stem if source.suffix in (".zip", ".py") else source.name)


@dataclass(slots=True)
class Opponent:
    """One opponent in one race.

    Attributes:
        agent: id of its kart.
        driver: its driver.
        view: what it observes and acts in, here.
        code: its driver's code, if it runs in this program.
        actor: its actor, likewise.
        instance: its driver's instance, if it runs elsewhere.
    """

    agent: str
    driver: Driver
    view: ViewFactory
    code: AgentCode | None = None
    actor: Actor | None = None
    instance: DriverInstance | None = None

    @property
    def group(self) -> int:
        """Equal for opponents whose actions are picked together."""
        return id(self.code if self.code and self.code.act_together else self)

    def copy(self) -> Opponent:
        """The same opponent at this moment.

        Raises:
            AgentException: what it remembers cannot be copied.
        """
        if self.instance is not None:
            raise self._uncopied(
                "it runs in a process of its own; let it run here, by "
                f"find_driver({self.driver.source!r}, inline=True)"
            )
        parts = self.actor.args if isinstance(self.actor, partial) else (self.actor,)
        if any(isinstance(part, FunctionType) and part.__closure__ for part in parts):
            raise self._uncopied("a function keeps it; give an object with __call__")
        try:
            return replace(self, actor=copy.deepcopy(self.actor))
        except Exception as error:
            raise self._uncopied(in_words(error)) from error

    def _uncopied(self, why: str) -> AgentException:
        return AgentException(
            f"opponent {name_of(self.driver)!r} of {self.agent} cannot be saved: {why}", self.agent
        )


@dataclass(frozen=True, slots=True)
class OpponentsMoment:
    """The opponents of a race at one moment; nobody changes it.

    Attributes:
        opponents: those that the game does not drive, and that have not failed.
        present: ids of those that still race.
        observations: what they see.
        memory: what their wrappers remember.
    """

    opponents: tuple[Opponent, ...]
    present: tuple[str, ...]
    observations: dict[str, Any]
    memory: ChainsMemory


class RaceOpponents:
    """The opponents in the races of one environment.

    Args:
        choice: what was asked for.
        num_agents: the number of agents.
        count: the number of opponents.
        view: the view of the first agent, which is that of policies that name none.
    """

    def __init__(
        self, choice: OpponentChoice, num_agents: int, count: int, view: ViewFactory
    ) -> None:
        self._choice, self._view = choice, view
        self._ids = tuple(f"kart_{num_agents + number}" for number in range(count))
        self._known_chains: dict[tuple[tuple[str, ViewFactory], ...], AgentChains] = {}
        self._opponents: dict[str, Opponent] = {}  # all that have not failed
        self._present: tuple[str, ...] = ()  # those of them that have not finished
        self._observations: dict[str, Any] | None = {}  # None after a step
        self._chains = self._chains_here()

    def draw(self, random: np.random.Generator, difficulty: int | None) -> Lineup:
        """The drivers of the next race; see :meth:`OpponentChoice.draw`."""
        return self._choice.draw(len(self._ids), random, difficulty)

    def specs(self, drivers: Sequence[Driver]) -> list[AgentSpec]:
        """How the drivers' karts start."""
        return [
            AgentSpec(use_ai=own.is_game_ai, name=name_of(own), camera_mode=CameraMode.OFF)
            for own in drivers
        ]

    def begin(self, drivers: Sequence[Driver], episode: Episode) -> None:
        """Starts the drivers of a race; one that fails is out of it.

        Args:
            drivers: one for each opponent.
            episode: the race.
        """
        self.close()
        seed = episode.race.seed
        requests: list[DriverRequest] = []
        for number, (agent, driver) in enumerate(zip(self._ids, drivers, strict=True)):
            if driver.is_game_ai:
                continue
            seen = kart_observation_space(extras=driver.extras)
            request = DriverRequest(agent, seen, kart_action_space(), seed + number)
            opponent = Opponent(agent, driver, full_with(driver.extras))
            self._opponents[agent] = opponent
            requests.append(request)
            self.attempt(opponent, partial(self._start, opponent, request))
        self._chains = self._chains_here()
        for request in requests:
            if (started := self._opponents.get(request.agent)) is not None:
                self.attempt(started, partial(self._get_ready, started, request))
        self._present = tuple(self._opponents)
        infos: dict[str, dict[str, Any]] = {agent: {} for agent in self._present}
        self._observations, _ = self._chains.reset(self._present, episode, infos, seed=seed)

    @property
    def is_driving(self) -> bool:
        """Whether there is a kart to drive, which the game does not."""
        return bool(self._present)

    def moment(self, episode: Episode) -> OpponentsMoment:
        """The opponents now, as a value.

        Raises:
            AgentException: what one remembers cannot be copied.
        """
        self._look(episode)
        return OpponentsMoment(
            tuple(opponent.copy() for opponent in self._opponents.values()),
            self._present,
            copy.deepcopy(self._observations or {}),
            self._chains.memory(),
        )

    def go_on_from(self, moment: OpponentsMoment) -> None:
        """Goes on from a :meth:`moment`, here or in another environment."""
        self.close()
        self._opponents = {own.agent: own.copy() for own in moment.opponents}
        self._present = moment.present
        self._observations = copy.deepcopy(moment.observations)
        self._chains = self._chains_here()
        self._chains.recall(moment.memory)

    def close(self) -> None:
        """Ends the drivers of the present race."""
        for opponent in self._opponents.values():
            if opponent.instance is not None:
                opponent.instance.close()
        self._opponents, self._present = {}, ()
        self._observations = {}

    def _start(self, opponent: Opponent, request: DriverRequest) -> None:
        driver = opponent.driver
        if driver.load is None:
            assert driver.start is not None  # noqa: S101 - not the game's AI
            opponent.instance = driver.start(request)
        else:
            opponent.code = self._choice.code(driver)
            opponent.view = opponent.code.wrap or self._view

    def _get_ready(self, opponent: Opponent, request: DriverRequest) -> None:
        if opponent.instance is not None:
            opponent.instance.ready()
        elif (code := opponent.code) is not None:
            seen = self._chains.observation_spaces[opponent.agent]
            acted = self._chains.action_spaces[opponent.agent]
            with code.scope:
                opponent.actor = code.make_actor(seen, acted, request.seed)

    def _chains_here(self) -> AgentChains:
        """The opponents' views; those whose own wrappers fail are out.

        Raises:
            ConfigError: opponents cannot have the agents' view.
        """
        try:
            return self._chains_of(self._opponents.values())
        except (AgentException, ConfigError):
            for opponent in list(self._opponents.values()):
                self._try_view(opponent)
        return self._chains_of(self._opponents.values())

    def _try_view(self, opponent: Opponent) -> None:
        try:
            self._chains_of([opponent])
        except (AgentException, ConfigError) as error:
            if opponent.view is self._view:
                raise ConfigError(
                    f"the opponent {name_of(opponent.driver)!r} cannot have the agents' view "
                    f"({error}); give it another, such as Driver.of_policy(policy, view='racing')"
                ) from error
            self.retire(opponent, error)

    def _chains_of(self, opponents: Iterable[Opponent]) -> AgentChains:
        views = {own.agent: own.view for own in opponents}
        key = tuple(views.items())
        if key not in self._known_chains:
            self._known_chains[key] = AgentChains(
                {agent: base_space(view) for agent, view in views.items()},
                {agent: kart_action_space() for agent in views},
                views,
                ignored=(),
                columns=CONTROLS,
            )
        return self._known_chains[key]

    def attempt(self, opponent: Opponent, call: Callable[[], Any]) -> Any:
        """What a call of a driver gives; ``None`` if it fails, and the driver is out."""
        try:
            return call()
        except (Exception, SystemExit) as error:  # noqa: BLE001 - costs only its own kart
            self.retire(opponent, error)

    def retire(self, opponent: Opponent, error: BaseException) -> None:
        """Takes an opponent that has failed out of the race; its kart rolls to a stop."""
        if self._opponents.pop(opponent.agent, None) is None:
            return
        if opponent.instance is not None:
            opponent.instance.close()
        text = printable(in_words(error))
        who = name_of(opponent.driver)
        logger.warning("opponent %s of %s is out of the race: %s", who, opponent.agent, text)

    # ------------------------------------------------------------------ a step

    def ask(self, episode: Episode) -> list[tuple[Opponent, Any]]:
        """Who acts now, and what each sees; those that run elsewhere begin to decide."""
        self._look(episode)
        seen = self._observations or {}
        asked = [self._opponents[agent] for agent in self._present]
        for opponent in asked:
            if opponent.instance is not None:
                self.attempt(opponent, partial(opponent.instance.ask, seen[opponent.agent]))
        return [(own, seen[own.agent]) for own in asked if own.agent in self._opponents]

    def write(self, actions: Mapping[str, Any], episode: Episode, controls: Controls) -> None:
        """Writes the opponents' controls.

        Args:
            actions: by opponent; those without one have failed.
            episode: the race.
            controls: ``(P, 7)`` of all player karts; takes those of the opponents.
        """
        while True:
            acting = tuple(agent for agent in self._present if agent in self._opponents)
            rows = episode.player_rows(acting)
            try:
                own = self._chains.decode(actions, acting, rows, len(controls), episode)
                break
            except (ActionError, AgentError) as error:
                agent = error.agent if isinstance(error, ActionError) else error.key
                self.retire(self._opponents[agent], error)
        controls[rows] = own[rows]
        self._present, self._observations = acting, None

    def _look(self, episode: Episode) -> None:
        """What those see that still race."""
        if self._observations is None:
            acted = self._present
            seen = self._chains.observe(acted, episode)
            infos: dict[str, dict[str, Any]] = {agent: {} for agent in acted}
            no = dict.fromkeys(acted, False)
            self._chains.finish(acted, (seen, dict.fromkeys(acted, 0.0), no, dict(no), infos))
            self._observations = seen
        finished = episode.snapshot.karts["has_finished_race"]
        if finished.any():
            karts = episode.karts(self._present).tolist()
            pairs = zip(self._present, karts, strict=True)
            self._present = tuple(agent for agent, kart in pairs if not finished[kart])


def drive_together(races: Sequence[tuple[RaceOpponents, Episode, Controls]]) -> None:
    """Has the opponents of some races decide, and writes their controls.

    Those that run elsewhere decide at the same time, and the karts of one driver that can drive
    several are driven by one call.

    Args:
        races: each race's opponents, its episode, and the controls ``(P, 7)`` of its player karts,
            which take those of the opponents.
    """
    actions: list[dict[str, Any]] = [{} for _ in races]
    groups: dict[int, list[tuple[int, Opponent, Any]]] = {}
    elsewhere: list[tuple[int, Opponent]] = []
    for number, (race, episode, _) in enumerate(races):
        for opponent, seen in race.ask(episode):
            if opponent.instance is not None:
                elsewhere.append((number, opponent))
            else:
                groups.setdefault(opponent.group, []).append((number, opponent, seen))
    for group in groups.values():
        picked, error = _picked([own for _, own, _ in group], [seen for *_, seen in group])
        for (number, opponent, _), action in zip(group, picked, strict=False):
            actions[number][opponent.agent] = action
        if error is not None:
            for number, opponent, _ in group:
                races[number][0].retire(opponent, error)
    for number, opponent in elsewhere:
        assert opponent.instance is not None  # noqa: S101 - see above
        decision = races[number][0].attempt(opponent, opponent.instance.answer)
        if decision is not None:
            actions[number][opponent.agent] = decision.action
    for (race, episode, controls), own in zip(races, actions, strict=True):
        race.write(own, episode, controls)


def _picked(
    opponents: Sequence[Opponent], seen: Sequence[Any]
) -> tuple[Sequence[Any], BaseException | None]:
    """The actions of the opponents of a group, or why there are none."""
    code = opponents[0].code
    assert code is not None  # noqa: S101 - it runs in this program
    actors: list[Any] = [opponent.actor for opponent in opponents]
    try:
        with code.scope:
            if code.act_together is None:
                return [actors[0](seen[0])], None
            actions = code.act_together(actors, seen)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - the driver's own code
        return (), error
    if len(actions) == len(seen):
        return actions, None
    return (), AgentError(f"it gave {len(actions)} actions for {len(seen)} karts")
