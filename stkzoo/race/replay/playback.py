"""Runs a recorded race again and compares every step."""

from __future__ import annotations

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


@dataclass(frozen=True, slots=True)
class Playback:
    """What came of playing a replay.

    Attributes:
        result: how the race ended. Where all was as recorded this is the recorded result,
            with what went wrong in the agents then.
        steps: steps played.
        first_difference: the first step after which a kart was not where it had been, 0 on
            the grid; ``None`` if all were, to the last bit.
    """

    result: RaceResult
    steps: int
    first_difference: int | None

    @property
    def is_exact(self) -> bool:
        """Whether everything was as recorded."""
        return self.first_difference is None


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
    return Playback(judge.told(result), judge.steps, judge.first_difference)


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

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._compare(race)

    def told(self, result: RaceResult) -> RaceResult:
        """The recorded result if this race came to it."""
        recorded, replay = self._replay.result, self._replay
        is_whole = self.steps == replay.steps and not replay.is_partial
        if recorded is None or self.first_difference is not None or not is_whole:
            return result
        return replace(recorded, wall_time=result.wall_time)

    def _compare(self, race: RaceProgress) -> None:
        replay, snapshot = self._replay, race.env.snapshot
        assert snapshot is not None  # noqa: S101 - a race runs
        self.steps = race.steps
        self._digest = next_digest(self._digest, snapshot)
        if self.first_difference is None and self._digest != replay.digests[race.steps].tobytes():
            self.first_difference = race.steps
            if not self._to_the_end:
                race.stop(_DIFFERS)
        if race.steps == replay.steps:
            race.stop(replay.status)


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
