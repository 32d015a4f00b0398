"""Replays a recorded race and compares each step with the recording."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import check_type
from stkzoo._installation import pip_install
from stkzoo.drivers.driver import Driver
from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import action_of
from stkzoo.race.listeners import ForwardingListener, RaceListener, RaceProgress
from stkzoo.race.replay.file import Replay, ReplayError, next_digest
from stkzoo.race.result import AgentFailure, RaceResult, versions_now
from stkzoo.race.runner import run_race
from stkzoo.render.scene import Ghost

_DIFFERS = "differs"
#: Fields of a replay that are also settings of a race.
_SETTINGS = ("laps", "difficulty", "reverse", "mode", "kart", "seed", "max_paths")
_RACE_FACTS = "track", "reverse", "mode", "laps", "difficulty", "seed", "race_length", "steps"
_AGENT_FACTS = ("start_position", "rank", "finish_time", "laps", "distance", "reward")


@dataclass(frozen=True, slots=True)
class Playback:
    """Outcome of playing a replay.

    Attributes:
        result: result of the race; for an exact replay, the recorded result with the agents'
            recorded failures.
        steps: number of steps played.
        first_difference: number of steps after which the state of a kart first differs in any bit,
            0 on the grid; ``None`` if there is no difference.
        result_differences: descriptions of the differences between the recorded result and this
            one. If there are any although ``first_difference`` is ``None``, the file was modified.
    """

    result: RaceResult
    steps: int
    first_difference: int | None
    result_differences: tuple[str, ...] = ()

    @property
    def is_exact(self) -> bool:
        """Whether all states and the result equal the recording."""
        return self.first_difference is None and not self.result_differences


def play_replay(
    replay: Replay,
    *,
    listeners: Sequence[RaceListener] = (),
    to_the_end: bool = False,
    any_engine: bool = False,
) -> Playback:
    """Runs a recorded race again in the engine and compares the states of all karts.

    The drivers are not required: the replay contains their actions, and the game's AI is
    deterministic.

    Args:
        replay: the recorded race.
        listeners: listeners of the race; see :func:`~stkzoo.race.run_race`.
        to_the_end: continue after a difference.
        any_engine: also accept a replay of another engine version, which may behave differently.

    Raises:
        ReplayError: another engine version recorded the replay.
        ConfigError: its track or karts are missing.
        AssetError: the game's data is missing.
        EngineError: the game crashed or hung.
        RaceInterrupted: Ctrl-C interrupted the race.
    """
    _check_engine(replay, any_engine)
    comparison = _Comparison(replay, to_the_end)
    watching = [_WithRecordedFailures(listener, replay, comparison) for listener in listeners]
    result = run_race(
        [_driver(replay, number) for number in range(len(replay.agents))],
        listeners=[comparison, *watching],
        start_positions=replay.start_positions,
        # The number of tracks to draw from affects the random numbers that are drawn after it.
        track=(replay.track,) * replay.num_tracks,
        **{name: getattr(replay, name) for name in _SETTINGS},
        max_steps=replay.steps + 1,  # the comparison ends the race one step earlier
        action_timeout=None,
    )
    return comparison.playback(result)


def other_versions(replay: Replay) -> str:
    """Returns this machine's versions that differ from those of a recording; empty if none do.

    Another version may be why a race differs.
    """
    check_type("replay", replay, Replay, "a Replay from load_replay(path)")
    here = versions_now()
    others = (name for name, version in here.items() if replay.versions.get(name) != version)
    return ", ".join(f"{name} {here[name]}" for name in others)


def _check_engine(replay: Replay, any_engine: bool) -> None:
    check_type("replay", replay, Replay, "a Replay from load_replay(path)")
    recorded, here = replay.versions.get("pystk2"), versions_now()["pystk2"]
    if recorded != here and not any_engine:
        raise ReplayError(
            f"the replay was recorded with version {recorded} of the engine; version {here} is "
            "installed and may drive differently: "
            f"{pip_install(f'PySuperTuxKart2=={recorded}')}, or "
            "play it anyway with any_engine=True (--any-engine)"
        )


def _driver(replay: Replay, number: int) -> Driver:
    agent = replay.agents[number]
    if agent.is_game_ai:
        return Driver(agent.name, None, agent.source)

    driver = recorded_driver(agent.name, replay.controls[:, number])
    return replace(driver, source=agent.source)


def recorded_driver(name: str, controls: npt.NDArray[np.float32]) -> Driver:
    """Returns a driver that repeats recorded controls ``(T, 7)`` and ignores its observations."""

    def make_actor(_: spaces.Space[Any], __: spaces.Space[Any], ___: int) -> Callable[..., Any]:
        rows = iter(controls)
        return lambda _: action_of(next(rows))

    return Driver.of_actor(name, make_actor)


class _Comparison(RaceListener):
    """Listener that compares the race with the recording and ends it at the same step."""

    def __init__(self, replay: Replay, to_the_end: bool) -> None:
        self._replay, self._to_the_end = replay, to_the_end
        self._digest = b""
        self.steps = 0
        self.first_difference: int | None = None

    def env_options(self) -> dict[str, Any]:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        return {"step_size": self._replay.step_size}

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._compare(race)
        if race.race_info.seed != self._replay.engine_seed:
            self._differ(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._compare(race)

    def playback(self, result: RaceResult) -> Playback:
        """Returns the outcome of playing, from the result of the race."""
        recorded, replay = None, self._replay
        if self.steps == replay.steps and self.first_difference is None and not replay.is_partial:
            recorded = replay.result
        differences = () if recorded is None else _differences(recorded, result)
        if recorded is not None and not differences:
            result = replace(recorded, wall_time=result.wall_time)
        return Playback(result, self.steps, self.first_difference, differences)

    def _compare(self, race: RaceProgress) -> None:
        replay = self._replay
        self.steps = race.steps
        self._digest = next_digest(self._digest, race.snapshot)
        if self.first_difference is None and self._digest != replay.digests[race.steps].tobytes():
            self._differ(race)
        elif race.steps == replay.steps:
            race.stop(_DIFFERS if self.first_difference is not None else replay.status)

    def _differ(self, race: RaceProgress) -> None:
        self.first_difference = race.steps
        if not self._to_the_end or race.steps == self._replay.steps:
            race.stop(_DIFFERS)


def _differences(recorded: RaceResult, result: RaceResult) -> tuple[str, ...]:
    """Returns descriptions of the differences in what depends only on the race."""
    then, now = _facts(recorded), _facts(result)
    return tuple(
        f"{name} is {now.get(name)}, and {then.get(name)} in the file"
        for name in sorted(then.keys() | now.keys())
        if not _is_equal(then.get(name), now.get(name))
    )


def _facts(result: RaceResult) -> dict[str, Any]:
    facts = {name: getattr(result, name) for name in _RACE_FACTS}
    for row in result.agents:
        facts |= {f"{row.agent}'s {name}": getattr(row, name) for name in _AGENT_FACTS}
    return facts


def _is_equal(one: Any, two: Any) -> bool:
    if isinstance(one, float) and isinstance(two, float):  # the kernel and numpy round differently
        return math.isclose(one, two, rel_tol=1e-4, abs_tol=1e-2)
    return bool(one == two)


def _has_happened(failure: AgentFailure, steps: int) -> bool:
    """Returns whether a race has shown a failure after a number of steps.

    A failure in a decision shows when the step that follows it has ended.
    """
    is_on_the_grid = failure.kind == "start" and failure.step == 0
    return is_on_the_grid or failure.step < steps


class _WithRecordedFailures(ForwardingListener):
    """Wraps a listener and shows it the recorded failures.

    No agent fails in a replay, because the recording contains the replacement actions.
    """

    def __init__(self, listener: RaceListener, replay: Replay, comparison: _Comparison) -> None:
        super().__init__(listener)
        self._comparison = comparison
        agents = replay.result.agents if replay.result else ()
        self._failures = {row.agent: row.errors for row in agents}

    def ended(self, result: RaceResult) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        super().ended(self._comparison.playback(result).result)

    def _forward(self, call: Callable[..., None], *arguments: Any) -> None:
        now = (self._now(one) if isinstance(one, RaceProgress) else one for one in arguments)
        super()._forward(call, *now)

    def _now(self, race: RaceProgress) -> RaceProgress:
        failures = {
            agent: tuple(failure for failure in failures if _has_happened(failure, race.steps))
            for agent, failures in self._failures.items()
        }
        return replace(race, failures=failures, seconds={})


# ---------------------------------------------------------------------- ghosts


def ghost_of(replay: Replay) -> Ghost:
    """Plays a replay and returns the way of its winner until the finish.

    Args:
        replay: the recorded race.

    Raises:
        ReplayError: the replay cannot be played (see :func:`.play_replay`), or the race differs
            from the recording.
        ConfigError: the race ended before it started to count the time.
    """
    recorder = _Recorder()
    playback = play_replay(replay, listeners=[recorder])
    if playback.first_difference is not None:
        raise ReplayError(
            f"the replay has no ghost: its race differs after step {playback.first_difference} of "
            f"{replay.steps}; expected a race that runs as recorded, see `stkzoo replay FILE`"
        )
    times = np.array(recorder.times)
    begin = int(np.flatnonzero(times <= 0)[-1])
    end = np.searchsorted(times, recorder.finish_time) if recorder.finish_time else len(times) - 1
    if begin >= end:
        raise ConfigError("the replay ends before the race begins; record a longer one")
    rows = slice(begin, int(end) + 1)
    places = np.array(recorder.places[rows], np.float64)[:, recorder.winner]
    return Ghost(replay.track, replay.reverse, recorder.winner_name, times[rows], places)


class _Recorder(RaceListener):
    """Records the race times and the places of all karts."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.places: list[npt.NDArray[np.float32]] = []
        self.finish_time = 0.0

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.stepped(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        karts = race.snapshot.karts
        self.times.append(float(race.snapshot.header["time"]))
        self.places.append(karts["location"][:, ::2].copy())
        self.winner = int(karts["position"].argmin())
        self.winner_name = race.scene.names[self.winner]
        if karts["has_finished_race"][self.winner]:
            self.finish_time = float(karts["finish_time"][self.winner])
