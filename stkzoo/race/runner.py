"""Runs one race."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stkzoo.config import AgentSpec
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.errors import AgentError, ConfigError, StkzooError
from stkzoo.race.drivers import Actor, Driver, find_driver
from stkzoo.race.result import AgentResult, RaceResult

__all__ = ["RaceListener", "RaceProgress", "run_race"]

#: Whoever is slower than this on the whole way, after the start, is not waited for ...
_SLOWEST = 4.0  # [m/s]
#: ... when this much time has passed besides.
_GRACE = 60.0  # [s]


@dataclass(frozen=True, slots=True)
class RaceProgress:
    """How far a race has come.

    Attributes:
        steps: environment steps so far.
        race_time: game time of these steps [s].
        race_length: laps times the lap's length [m].
        distances: metres driven by each agent, at most ``race_length``.
    """

    steps: int
    race_time: float
    race_length: float
    distances: Mapping[str, float]

    @property
    def leader_distance(self) -> float:
        """Metres driven by whoever has come farthest."""
        return max(self.distances.values())


#: Is told of the progress once before the first step and after every step.
RaceListener = Callable[[RaceProgress], None]


def run_race(
    drivers: Sequence[str | Driver],
    *,
    track: str | None = None,
    laps: int = 1,
    difficulty: int = 2,
    reverse: bool = False,
    seed: int = 0,
    max_steps: int | None = None,
    listener: RaceListener | None = None,
) -> RaceResult:
    """Runs one race until everybody has finished.

    Every driver has a kart and is an agent of one
    :class:`~stkzoo.env.parallel.RaceParallelEnv`; starting places are drawn.

    Args:
        drivers: who drives: drivers or their names (:func:`~stkzoo.race.find_driver`).
        track: a track's name; ``None`` draws one.
        laps: number of laps.
        difficulty: level of the game's AI, 0 to 3.
        reverse: drive the track the other way round.
        seed: decides all that is left to chance.
        max_steps: the race is over after so many steps. By default it is over when a kart
            could have done the whole way at 4 m/s and a minute more has passed: those who
            have not finished then will not.
        listener: is told of the progress after every step.

    Returns:
        The result; an agent that has not finished has no finish time in it.

    Raises:
        ConfigError: an argument cannot be.
        AssetError: the game's data is missing.
        AgentError: a driver failed; it names the agent.
        EngineError: the game died or hangs.
    """
    if not drivers:
        raise ConfigError("no drivers; name at least one, such as 'heuristic'")
    _check_whole("seed", seed, 0)
    if max_steps is not None:
        _check_whole("max_steps", max_steps, 1)
    crew = [find_driver(driver) if isinstance(driver, str) else driver for driver in drivers]
    with RaceParallelEnv(
        agents=[AgentSpec(use_ai=driver.is_game_ai, name=driver.name) for driver in crew],
        num_kart=len(crew),
        track=track,
        laps=laps,
        difficulty=difficulty,
        reverse=reverse,
        max_cycles=None,
        view={f"kart_{number}": driver.view for number, driver in enumerate(crew)},
    ) as env:
        return _Run(env, crew, seed, listener).to_the_end(max_steps)


class _Run:
    """One race under way."""

    def __init__(
        self,
        env: RaceParallelEnv,
        crew: Sequence[Driver],
        seed: int,
        listener: RaceListener | None,
    ) -> None:
        self._begin = time.monotonic()
        self._env, self._seed, self._listener = env, seed, listener
        self._drivers = dict(zip(env.possible_agents, crew, strict=True))
        self._observations, self._infos = env.reset(seed=seed)
        assert env.track_map is not None  # noqa: S101 - since reset
        self._length = env.track_map.length * env.options.laps
        self._actors = self._make_actors()
        self._rewards = dict.fromkeys(env.possible_agents, 0.0)
        self._steps = 0

    def to_the_end(self, max_steps: int | None) -> RaceResult:
        """Steps until everybody has finished, or the limit."""
        limit = self._patience() if max_steps is None else max_steps
        self._tell()
        while self._env.agents and self._steps < limit:
            self._step()
            self._tell()
        return self._result()

    def _patience(self) -> int:
        return round((self._length / _SLOWEST + _GRACE) / self._env.options.step_size)

    def _make_actors(self) -> dict[str, Actor]:
        actors = {}
        for number, (agent, driver) in enumerate(self._drivers.items()):
            if driver.make_actor is not None:
                spaces = self._env.observation_space(agent), self._env.action_space(agent)
                with _failures_of(agent, driver):
                    actors[agent] = driver.make_actor(*spaces, self._seed + number)
        return actors

    def _step(self) -> None:
        actions = {}
        for agent in self._env.agents:
            if agent in self._actors:
                with _failures_of(agent, self._drivers[agent]):
                    actions[agent] = self._actors[agent](self._observations[agent])
        self._observations, rewards, _, _, infos = self._env.step(actions)
        self._infos.update(infos)
        for agent, reward in rewards.items():
            self._rewards[agent] += reward
        self._steps += 1

    def _tell(self) -> None:
        if self._listener is not None:
            distances = {
                agent: min(info["distance"], self._length) for agent, info in self._infos.items()
            }
            game_time = self._steps * self._env.options.step_size
            self._listener(RaceProgress(self._steps, game_time, self._length, distances))

    def _result(self) -> RaceResult:
        race = self._env.race
        assert race is not None  # noqa: S101 - since reset
        rows = [self._agent_result(agent) for agent in self._env.possible_agents]
        return RaceResult(
            track=race.track,
            reverse=race.reverse,
            laps=race.laps,
            difficulty=race.difficulty,
            seed=self._seed,
            race_length=self._length,
            steps=self._steps,
            agents=tuple(sorted(rows, key=lambda row: row.rank)),
            wall_time=time.monotonic() - self._begin,
        )

    def _agent_result(self, agent: str) -> AgentResult:
        info: Mapping[str, Any] = self._infos[agent]
        return AgentResult(
            agent=agent,
            driver=self._drivers[agent].name,
            rank=info["position"],
            finish_time=info["finish_time"] or None,
            laps=info["lap"],
            distance=info["distance"],
            reward=self._rewards[agent],
        )


def _check_whole(name: str, value: object, low: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < low:
        raise ConfigError(f"{name} is {value!r}, expected a whole number of {low} or more")


class _failures_of:  # noqa: N801 - a context manager reads as a phrase
    """Turns whatever a driver's code raises into an :class:`AgentError` that names the agent."""

    def __init__(self, agent: str, driver: Driver) -> None:
        self._agent, self._driver = agent, driver

    def __enter__(self) -> None:
        return None

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: Any
    ) -> None:
        if isinstance(error, Exception) and not isinstance(error, StkzooError):
            raise AgentError(
                f"driver {self._driver.name!r} of {self._agent} failed: "
                f"{type(error).__name__}: {error}",
                self._agent,
            ) from error
