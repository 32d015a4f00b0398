"""Runs one race."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from stkzoo._checks import check_type
from stkzoo._schema import distinct_name, plain_name
from stkzoo.config import AgentSpec
from stkzoo.drivers.driver import Driver, find_driver
from stkzoo.drivers.instances import DriverRequest
from stkzoo.drivers.sandbox import (
    NONE,
    own_cores,
    protections,
    sandbox_kind,
    say_what_is_missing,
)
from stkzoo.env.episode import Episode
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.errors import ActionError, ConfigError
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.racing_driver import RacingDriver
from stkzoo.race.rescues import RescueCounter
from stkzoo.race.result import ActionTime, AgentResult, RaceResult, versions_now
from stkzoo.race.settings import RaceSettings
from stkzoo.views import full_with

#: Settings that are also options of the environment and facts of the result.
_RACE_OPTIONS = ("track", "laps", "difficulty", "reverse", "mode")
#: Without ``max_steps``, the time limit is the race length divided by this speed [m/s] ...
_SLOWEST = 4.0
#: ... plus this time [s].
_GRACE = 60.0


class RaceInterrupted(KeyboardInterrupt):
    """Raised when Ctrl-C interrupts a race.

    Attributes:
        result: the result so far; its ``status`` is ``"interrupted"``.
    """

    def __init__(self, result: RaceResult) -> None:
        super().__init__()
        self.result = result


def run_race(
    drivers: Sequence[str | Driver],
    *,
    listeners: Sequence[RaceListener] = (),
    settings: RaceSettings | None = None,
    start_positions: Sequence[int] | None = None,
    wait_for: Sequence[int] | None = None,
    **changes: Any,
) -> RaceResult:
    """Runs one race until all karts have finished or a limit ends it.

    Each driver drives one kart and is an agent of one
    :class:`~stkzoo.env.parallel.RaceParallelEnv`. Each agent from files runs in its own process, so
    its failures affect only its own kart.

    Args:
        drivers: drivers or their names (:func:`~stkzoo.race.find_driver`).
        listeners: listeners of the race.
        settings: settings of the race; ``None`` for the defaults.
        start_positions: grid position of each driver, from 1 at the front; random by default.
        wait_for: indices of drivers. The race ends as soon as all of these drivers have finished or
            retired.
        changes: fields of :class:`~stkzoo.race.RaceSettings` that override ``settings``, such as
            ``track="lighthouse"``.

    Returns:
        The result of the race. Agents that have not finished have no finish time.

    Raises:
        ConfigError: an argument is invalid.
        AssetError: the game's data is missing.
        AgentError: a driver failed and ``error_handling`` is ``"raise"``. The error names the
            agent.
        EngineError: the game crashed or hung.
        RaceInterrupted: Ctrl-C interrupted the race. The exception contains the result so far.
    """
    check_type("drivers", drivers, Sequence, "a list of drivers or their names")
    if not drivers:
        raise ConfigError("no drivers; name at least one, such as 'heuristic'")
    _check_listeners(listeners)
    chosen = RaceSettings.changed(settings, changes)
    places = _places(start_positions, len(drivers))
    awaited = _awaited(wait_for, len(drivers))
    entries = [_driver(driver, chosen) for driver in drivers]
    chosen = _of_level(chosen, entries)
    _sandbox(chosen, entries)  # raises or warns before the race starts
    with ExitStack() as resources:
        for listener in listeners:
            resources.callback(listener.closed)
        env = resources.enter_context(_env(entries, chosen, places, listeners))
        race = _RaceRun(env, entries, awaited, chosen, listeners)
        for member in race.members.values():
            resources.callback(member.close)
        return race.run()


def _check_listeners(listeners: Sequence[RaceListener]) -> None:
    is_list = isinstance(listeners, Sequence) and not isinstance(listeners, str)
    if not is_list or not all(isinstance(listener, RaceListener) for listener in listeners):
        raise ConfigError(f"listeners is {listeners!r}, expected a list of RaceListener objects")


def _driver(driver: str | Driver, settings: RaceSettings) -> Driver:
    if isinstance(driver, Driver):
        return driver
    return find_driver(driver, inline=settings.inline, adapter=settings.adapter)


def _of_level(settings: RaceSettings, drivers: Sequence[Driver]) -> RaceSettings:
    """Returns the settings with the difficulty that drivers require, if any.

    Raises:
        ConfigError: drivers require different difficulties.
    """
    levels = {driver.difficulty for driver in drivers if driver.difficulty is not None}
    if len(levels) > 1:
        raise ConfigError(
            f"drivers require the difficulties {sorted(levels)}, but the game's AI has one level "
            "per race; choose one"
        )
    return replace(settings, difficulty=levels.pop()) if levels else settings


def _sandbox(settings: RaceSettings, drivers: Sequence[Driver]) -> str | None:
    """Returns the sandbox of the agents from files; ``None`` if there are no such agents."""
    if not any(driver.is_from_files for driver in drivers):
        return None
    if settings.inline:
        return NONE
    say_what_is_missing(settings.sandbox)
    return sandbox_kind(settings.sandbox)


def _places(start_positions: Sequence[int] | None, count: int) -> list[int | None]:
    if start_positions is None:
        return [None] * count
    if not _are_whole(start_positions) or sorted(start_positions) != list(range(1, count + 1)):
        raise ConfigError(f"start_positions is {start_positions}, expected 1 to {count}, each once")
    return [int(position) - 1 for position in start_positions]


def _are_whole(numbers: object) -> bool:
    return isinstance(numbers, Sequence) and all(isinstance(n, (int, np.integer)) for n in numbers)


def _awaited(wait_for: Sequence[int] | None, count: int) -> list[str]:
    if wait_for is None:
        return []
    if not _are_whole(wait_for) or not wait_for or not set(wait_for) <= set(range(count)):
        raise ConfigError(
            f"wait_for is {wait_for}, expected some of the drivers' numbers, 0 to {count - 1}"
        )
    return [f"kart_{number}" for number in wait_for]


def _env(
    drivers: Sequence[Driver],
    settings: RaceSettings,
    places: Sequence[int | None],
    listeners: Sequence[RaceListener],
) -> RaceParallelEnv:
    options: dict[str, Any] = {}
    for listener in listeners:
        options |= listener.env_options()
    count, kart = len(drivers), settings.kart or ""
    sources = [driver.source for driver in drivers]
    teams = map(sources.index, sources) if settings.teams else [None] * count
    return RaceParallelEnv(
        agents=[
            AgentSpec(
                place, driver.is_game_ai, driver.name, kart=kart, color=number / count, team=team
            )
            for number, (driver, place, team) in enumerate(zip(drivers, places, teams, strict=True))
        ],
        num_kart=count,
        **{name: getattr(settings, name) for name in (*_RACE_OPTIONS, "max_paths")},
        max_cycles=None,
        view={f"kart_{n}": full_with(driver.extras) for n, driver in enumerate(drivers)},
        **options,
    )


class _RaceRun:
    """One run of a race, from the start to the result."""

    def __init__(
        self,
        env: RaceParallelEnv,
        drivers: Sequence[Driver],
        awaited: Sequence[str],
        settings: RaceSettings,
        listeners: Sequence[RaceListener],
    ) -> None:
        self._begin = time.monotonic()
        self._versions, self._sandbox = versions_now(), _sandbox(settings, drivers)
        self._env, self._settings, self._listeners = env, settings, listeners
        self._drivers = dict(zip(env.possible_agents, drivers, strict=True))
        self._awaited = awaited
        self._rescues = RescueCounter(len(self._drivers))
        files = [agent for agent, driver in self._drivers.items() if driver.is_from_files]
        cores = {agent: own_cores(number, len(files)) for number, agent in enumerate(files)}
        self._protections: tuple[str, ...] = ()
        if self._sandbox is not None and not settings.inline:
            cores_apart = ("cores",) if any(cores.values()) else ()
            self._protections = (*protections(self._sandbox), *cores_apart)
        self.members = {
            agent: RacingDriver(
                driver,
                DriverRequest(
                    agent,
                    env.observation_spaces[agent],
                    env.action_spaces[agent],
                    settings.seed + number,
                    settings.limits,
                    cores=cores.get(agent, ()),
                    env=env,
                ),
                settings,
            )
            for number, (agent, driver) in enumerate(self._drivers.items())
            if not driver.is_game_ai
        }
        self._steps = 0
        self._stop = ""
        self._steps_at_first = math.inf  # when the first kart finished
        self._actions: dict[str, Any] = {}
        self._rewards: dict[str, float] = {}
        self._totals = dict.fromkeys(env.possible_agents, 0.0)

    def run(self) -> RaceResult:
        """Runs the race and notifies the listeners."""
        self._start()
        try:
            self._notify("started")
            while not (status := self._ending()):
                self._step()
                self._notify("stepped")
        except KeyboardInterrupt:
            raise RaceInterrupted(self._end("interrupted")) from None
        return self._end(status)

    def _start(self) -> None:
        for member in self.members.values():
            member.start(0)
        for member in self.members.values():
            member.get_ready(0)
        self._names: dict[str, str] = {}
        for agent, driver in self._drivers.items():
            name = plain_name(self.members.get(agent, driver).name) or agent
            others = (
                taken
                for other, taken in self._names.items()
                if self._drivers[other].source != driver.source
            )
            self._names[agent] = distinct_name(name, others)
        for spec, name in zip(self._env.specs, self._names.values(), strict=True):
            spec.name = name
        self._observations, self._infos = self._env.reset(seed=self._settings.seed)
        self._length = self._episode.track_map.length * self._env.options.laps
        patience = (self._length / _SLOWEST + _GRACE) / self._env.options.step_size
        self._patience = round(patience)

    def _step(self) -> None:
        asked = [self.members[agent] for agent in self._env.agents if agent in self.members]
        for member in asked:
            member.ask(self._observations[member.agent], self._steps)
        self._actions = {member.agent: member.answer(self._steps) for member in asked}
        self._observations, self._rewards, _, _, infos = self._step_checked()
        self._infos.update(infos)
        for agent, reward in self._rewards.items():
            self._totals[agent] += reward
        self._steps += 1
        snapshot = self._episode.snapshot
        self._rescues.update(snapshot.karts, float(snapshot.header["time"]))
        if self._num_finished():
            self._steps_at_first = min(self._steps_at_first, self._steps)

    def _step_checked(self) -> Any:
        """Steps the environment and replaces invalid actions."""
        while True:
            try:
                return self._env.step(self._actions)
            except ActionError as error:  # noqa: PERF203 - it is rare
                member = self.members[error.agent]
                self._actions[error.agent] = member.replace_action(error, self._steps)

    def _ending(self) -> str:
        """Returns the status of the race if it is over; otherwise an empty string."""
        settings, finished = self._settings, self._num_finished()
        if self._stop:
            return self._stop
        if not self._is_any_driving(self._env.agents):
            return "finished" if finished else "abandoned"
        if self._awaited and not self._is_any_driving(self._awaited):
            return "awaited_finished"
        if settings.karts_finished is not None and finished >= settings.karts_finished:
            return "karts_finished"
        if settings.max_steps is not None and self._steps >= settings.max_steps:
            return "max_steps"
        if self._steps - self._steps_at_first >= (settings.max_steps_after_first or math.inf):
            return "max_steps_after_first"
        if settings.max_steps is None and self._steps >= self._patience:
            return "time_limit"
        return ""

    def _is_any_driving(self, agents: Sequence[str]) -> bool:
        """Returns whether any of these agents has neither finished nor retired."""
        retired = {agent for agent, member in self.members.items() if member.is_retired}
        return bool(set(agents).intersection(self._env.agents) - retired)

    def _num_finished(self) -> int:
        return sum(info["finish_time"] > 0 for info in self._infos.values())

    # ------------------------------------------------------------------ listeners and result

    def _notify(self, event: str) -> None:
        if self._listeners:
            progress = self._progress()
            for listener in self._listeners:
                getattr(listener, event)(progress)

    def _progress(self) -> RaceProgress:
        return RaceProgress(
            env=self._env,
            names=MappingProxyType(self._names),
            sources={agent: driver.source for agent, driver in self._drivers.items()},
            seed=self._settings.seed,
            steps=self._steps,
            race_time=self._race_time,
            race_length=self._length,
            distances={
                agent: min(info["distance"], self._length) for agent, info in self._infos.items()
            },
            observations=MappingProxyType(self._observations),
            actions=MappingProxyType(self._actions),
            rewards=MappingProxyType(self._rewards),
            total_rewards=dict(self._totals),
            infos=dict(self._infos),
            failures={agent: tuple(member.failures) for agent, member in self.members.items()},
            seconds={agent: m.seconds[-1] for agent, m in self.members.items() if m.seconds},
            stop=self._set_stop,
        )

    def _set_stop(self, reason: str) -> None:
        self._stop = reason or "stopped"

    def _end(self, status: str) -> RaceResult:
        result = self._result(status)
        with ExitStack() as calls:  # calls all listeners, even if one of them fails
            for listener in reversed(self._listeners):
                calls.callback(listener.ended, result)
        return result

    @property
    def _episode(self) -> Episode:
        return self._env.live_race.running("run_race")

    @property
    def _race_time(self) -> float:
        return self._steps * self._env.options.step_size

    def _result(self, status: str) -> RaceResult:
        race = self._episode.race
        places = dict(zip(self._env.possible_agents, race.kart_indices, strict=True))
        rows = [self._agent_result(agent, places[agent] + 1) for agent in places]
        return RaceResult(
            status=status,
            **{name: getattr(race, name) for name in _RACE_OPTIONS},
            seed=self._settings.seed,
            race_length=self._length,
            steps=self._steps,
            race_time=self._race_time,
            agents=tuple(sorted(rows, key=lambda row: row.rank)),
            wall_time=time.monotonic() - self._begin,
            versions=self._versions,
            sandbox=self._sandbox,
            protections=self._protections,
            time_budget=self._settings.time_budget,
        )

    def _agent_result(self, agent: str, start_position: int) -> AgentResult:
        info: Mapping[str, Any] = self._infos[agent]
        member = self.members.get(agent)
        finish_time = info["finish_time"] or None
        status = "racing" if finish_time is None else "finished"
        if member is not None and member.is_retired and finish_time is None:
            status = "retired"
        return AgentResult(
            agent=agent,
            driver=self._names[agent],
            source=self._drivers[agent].source,
            status=status,
            start_position=start_position,
            rank=info["position"],
            finish_time=finish_time,
            laps=info["lap"],
            distance=min(info["distance"], self._length),
            reward=self._totals[agent],
            rescues=int(self._rescues.counts[start_position - 1]),
            num_errors=member.num_failures if member else 0,
            num_clipped=member.num_clipped if member else 0,
            errors=tuple(member.failures) if member else (),
            action_time=ActionTime.of(member.seconds, member.clock.used) if member else None,
        )
