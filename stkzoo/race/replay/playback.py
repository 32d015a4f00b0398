"""Runs a recorded race again and compares every step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gymnasium import spaces

from stkzoo.engine.assets import find_assets
from stkzoo.race.drivers import Driver
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.replay.file import ReplayError
from stkzoo.race.replay.record import Replay, action_of, next_digest
from stkzoo.race.result import RaceResult, versions_now
from stkzoo.race.runner import run_race

__all__ = ["Playback", "play_replay"]

_DIFFERS = "differs"
_RACE_FACTS = ("track", "reverse", "laps", "difficulty", "seed", "race_length", "steps")
_AGENT_FACTS = ("start_position", "rank", "finish_time", "laps", "distance", "reward")


@dataclass(frozen=True, slots=True)
class Playback:
    """What came of playing a replay.

    Attributes:
        result: how the race ended. Where all was as recorded this is the recorded result,
            with what went wrong in the agents then.
        steps: steps played.
        first_difference: the first step after which a kart was not where it had been, 0 on
            the grid; ``None`` if all were, to the last bit.
        result_differences: where the recorded result is not what the race came to, in
            words. Somebody has changed it, if all karts were where they had been.
    """

    result: RaceResult
    steps: int
    first_difference: int | None
    result_differences: tuple[str, ...] = ()

    @property
    def is_exact(self) -> bool:
        """Whether everything was as recorded."""
        return self.first_difference is None and not self.result_differences


def play_replay(
    replay: Replay,
    *,
    listeners: Sequence[RaceListener] = (),
    to_the_end: bool = False,
    any_engine: bool = False,
) -> Playback:
    """Runs a recorded race again, on the real engine, and checks where all karts are.

    The drivers themselves are not needed: what they did is in the replay, and the game's AI
    does the same again.

    Args:
        replay: the race.
        listeners: who watches, as in :func:`~stkzoo.race.run_race`.
        to_the_end: go on after a difference.
        any_engine: play it also with another version of the engine, which may drive
            differently.

    Raises:
        ReplayError: another engine recorded it, or its track is not there.
        AssetError: the game's data is missing.
        EngineError: the game died or hangs.
        RaceInterrupted: an interrupt from the keyboard.
    """
    _check_engine(replay, any_engine)
    _check_track(replay)
    judge = _Judge(replay, to_the_end)
    result = run_race(
        [_driver(replay, number) for number in range(len(replay.agents))],
        listeners=[judge, *(_Retold(listener, replay, judge) for listener in listeners)],
        start_positions=replay.start_positions,
        # As many choices as there were, so that the stream of random numbers is the same.
        track=(replay.track,) * replay.num_tracks,
        laps=replay.laps,
        difficulty=replay.difficulty,
        reverse=replay.reverse,
        seed=replay.seed,
        max_paths=replay.max_paths,
        max_steps=replay.steps + 1,  # the judge ends the race
        action_timeout=None,
    )
    differences = tuple(judge.differences(result))
    return Playback(judge.told(result), judge.steps, judge.first_difference, differences)


def _check_engine(replay: Replay, any_engine: bool) -> None:
    recorded, here = replay.versions.get("pystk2"), versions_now()["pystk2"]
    if recorded != here and not any_engine:
        raise ReplayError(
            f"the replay was recorded with version {recorded} of the engine, and here is {here}, "
            f"which may drive differently: pip install PySuperTuxKart2=={recorded}, or try it "
            "all the same with any_engine=True (--any-engine)"
        )


def _check_track(replay: Replay) -> None:
    known = find_assets().tracks
    if replay.track not in known:
        raise ReplayError(
            f"the replay's track {replay.track!r} is not among the {len(known)} tracks here; "
            "`stkzoo assets status` shows where the game's data comes from"
        )


def _driver(replay: Replay, number: int) -> Driver:
    agent = replay.agents[number]
    if agent.is_game_ai:
        return Driver(agent.name, None, agent.source)

    def make_actor(_: spaces.Space[Any], __: spaces.Space[Any], ___: int) -> Callable[..., Any]:
        rows = iter(replay.controls[:, number])
        return lambda _: action_of(next(rows))

    return replace(Driver.of_actor(agent.name, make_actor), source=agent.source)


class _Judge(RaceListener):
    """Compares the race with the recorded one, and ends it where that one ended."""

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
        info = race.env.race
        assert info is not None  # noqa: S101 - a race has started
        if info.seed != self._replay.engine_seed:
            self._differ(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._compare(race)

    def told(self, result: RaceResult) -> RaceResult:
        """The recorded result if this race came to it."""
        recorded = self._recorded()
        if recorded is None or self.differences(result):
            return result
        return replace(recorded, wall_time=result.wall_time)

    def differences(self, result: RaceResult) -> list[str]:
        """Where the recorded result is not what this race came to."""
        recorded = self._recorded()
        if recorded is None:
            return []
        then, now = _facts(recorded), _facts(result)
        return [
            f"{name} is {now.get(name)}, and {then.get(name)} in the file"
            for name in sorted(then.keys() | now.keys())
            if not _is_equal(then.get(name), now.get(name))
        ]

    def _recorded(self) -> RaceResult | None:
        """The recorded result, if this race is that one from start to end."""
        replay = self._replay
        is_whole = self.steps == replay.steps and not replay.is_partial
        return replay.result if is_whole and self.first_difference is None else None

    def _compare(self, race: RaceProgress) -> None:
        replay, snapshot = self._replay, race.env.snapshot
        assert snapshot is not None  # noqa: S101 - a race runs
        self.steps = race.steps
        self._digest = next_digest(self._digest, snapshot)
        if self.first_difference is None and self._digest != replay.digests[race.steps].tobytes():
            self._differ(race)
        elif race.steps == replay.steps:
            race.stop(_DIFFERS if self.first_difference is not None else replay.status)

    def _differ(self, race: RaceProgress) -> None:
        self.first_difference = race.steps
        if not self._to_the_end or race.steps == self._replay.steps:
            race.stop(_DIFFERS)


def _facts(result: RaceResult) -> dict[str, Any]:
    """What of a result follows from the race itself."""
    facts = {name: getattr(result, name) for name in _RACE_FACTS}
    for row in result.agents:
        facts |= {f"{row.agent}'s {name}": getattr(row, name) for name in _AGENT_FACTS}
    return facts


def _is_equal(one: Any, two: Any) -> bool:
    if isinstance(one, float) and isinstance(two, float):  # the kernel rounds otherwise than numpy
        return math.isclose(one, two, rel_tol=1e-4, abs_tol=1e-2)
    return bool(one == two)


class _Retold(RaceListener):
    """Tells a listener of the race with the failures of then.

    In a replay no agent fails: what was done in its place is recorded too.
    """

    def __init__(self, listener: RaceListener, replay: Replay, judge: _Judge) -> None:
        self._listener, self._judge = listener, judge
        agents = replay.result.agents if replay.result else ()
        self._failures = {row.agent: row.errors for row in agents}

    def env_options(self) -> dict[str, Any]:
        """See :class:`~stkzoo.race.listeners.RaceListener`, as for the others."""
        return self._listener.env_options()

    def started(self, race: RaceProgress) -> None:
        self._listener.started(self._now(race))

    def stepped(self, race: RaceProgress) -> None:
        self._listener.stepped(self._now(race))

    def ended(self, result: RaceResult) -> None:
        self._listener.ended(self._judge.told(result))

    def closed(self) -> None:
        self._listener.closed()

    def _now(self, race: RaceProgress) -> RaceProgress:
        failures = {
            agent: tuple(failure for failure in failures if failure.step <= race.steps)
            for agent, failures in self._failures.items()
        }
        return replace(race, failures=failures, seconds={})
