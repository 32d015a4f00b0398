"""How races of a vector environment start: ahead of time, or from a few starts that are copied."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stkzoo._checks import check_whole
from stkzoo.engine.fork_client import can_fork
from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import Session, WorkerSession
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError, EngineError, StkzooError
from stkzoo.names import Phase

logger = logging.getLogger(__name__)


def seeds_of_races(seed: int | Sequence[int | None] | None, num_races: int) -> list[int | None]:
    """Returns the seed of each race, from a common integer or a list.

    Raises:
        ConfigError: the seeds are invalid.
    """
    if seed is None:
        return [None] * num_races
    if isinstance(seed, (int, np.integer)):
        return [check_whole("seed", seed, 0) + number for number in range(num_races)]
    if not isinstance(seed, Sequence) or len(seed) != num_races:
        raise ConfigError(f"seed is {seed!r}, expected a whole number or {num_races}, one per race")
    return [
        race_seed if race_seed is None else check_whole("seed", race_seed, 0) for race_seed in seed
    ]


class AheadStarts:
    """Starts a race's successor in a second process while the race runs.

    Every race is the first one in its process, so starting it early does not change it.

    Args:
        new_session: makes a session.
    """

    def __init__(self, new_session: Callable[[], Session]) -> None:
        self._new_session = new_session
        self._next: tuple[RaceSetup, WorkerSession] | None = None

    def prepare(self, setup: RaceSetup) -> None:
        """Starts a race and returns at once. If that fails, :meth:`begin` tries again."""
        if self._next and self._next[0] == setup:
            return
        self.close()
        session = self._new_session()
        assert isinstance(session, WorkerSession)  # noqa: S101 - the environment checked it
        try:
            session.start_async(setup)
        except EngineError as error:
            logger.info("a race could not be started ahead: %s", error)
        else:
            self._next = setup, session

    def begin(self, setup: RaceSetup, session: Session) -> tuple[Session, RaceStart]:
        """Ends a session's race and begins another one: the one ahead if its setup matches.

        Args:
            setup: setup of the race.
            session: the session.

        Returns:
            The session with the race, which replaces the other one, and its start.

        Raises:
            ConfigError: the setup is invalid.
            EngineError: the game does not start.
        """
        if self._next is not None and self._next[0] == setup:
            _, ahead = self._next
            try:
                start = ahead.start_wait()
            except StkzooError as error:
                logger.info("a race that was started ahead was lost: %s", error)
            else:
                session.close()
                self._next = None
                return ahead, start
        self.close()
        return session, session.start(setup)

    def close(self) -> None:
        """Ends the race that was started ahead."""
        if self._next is not None:
            self._next[1].close()
            self._next = None


class RepeatedStarts:
    """Draws the seeds of races from a small set, and keeps the races' starts to copy them.

    A start waits in its own process. A copy of it gives the same race as a new start.

    Args:
        count: number of seeds in the set, and maximum number of starts to keep.
        new_session: makes a session in which a start can wait.
        seed: seed of the set; ``None`` draws another set in each :meth:`reseed`.
        skips_countdown: whether starts wait at GO, with all karts at full throttle.

    Raises:
        ConfigError: races cannot be copied on this system.
    """

    def __init__(
        self,
        count: int,
        new_session: Callable[[], Session],
        seed: int | None = None,
        skips_countdown: bool = False,
    ) -> None:
        if not can_fork():
            raise ConfigError(
                "num_starts needs races that can be copied, which is possible only on Linux "
                "without STKZOO_START_METHOD=spawn; leave num_starts out"
            )
        self._count, self._new_session = count, new_session
        self._seed, self._skips_countdown = seed, skips_countdown
        self._kept: OrderedDict[RaceSetup, tuple[Session, RaceStart]] = OrderedDict()
        self.reseed([])

    def reseed(self, seeds: Sequence[int | None]) -> None:
        """Draws another order of the seeds, and another set of them if the set has no seed.

        Args:
            seeds: determine both; without a number, they are random.
        """
        self._random = np.random.default_rng([s for s in seeds if s is not None] or None)
        of_set = self._random if self._seed is None else np.random.default_rng(self._seed)
        self._first = int(of_set.integers(2**31))

    def draw_seed(self) -> int:
        """Returns the seed of the next race."""
        return self._first + int(self._random.integers(self._count))

    def begin(self, setup: RaceSetup, session: Session) -> tuple[Session, RaceStart]:
        """As :meth:`AheadStarts.begin`, but copies a start that waits, or starts one that waits."""
        if setup in self._kept:
            self._kept.move_to_end(setup)
            waiting, start = self._kept[setup]
            try:
                session.resume(waiting)
            except EngineError as error:
                logger.info("a start that waited was lost: %s", error)
                self._forget(setup)
            else:
                return session, start
        waiting = self._new_session()
        try:
            start = waiting.start(setup)
            if self._skips_countdown:
                start = _after_countdown(waiting, setup, start)
            session.resume(waiting)
        except BaseException:
            waiting.close()
            raise
        self._kept[setup] = waiting, start
        if len(self._kept) > self._count:
            self._forget(next(iter(self._kept)))
        return session, start

    def close(self) -> None:
        """Ends the processes of all starts."""
        while self._kept:
            self._forget(next(iter(self._kept)))

    def __getstate__(self) -> dict[str, Any]:
        # A copy of the environment starts its own races.
        return {**vars(self), "_kept": OrderedDict()}

    def _forget(self, setup: RaceSetup) -> None:
        self._kept.pop(setup)[0].close()


def _after_countdown(session: Session, setup: RaceSetup, start: RaceStart) -> RaceStart:
    """Steps a race that has started until GO, and returns its start at that moment."""
    snapshot = start.snapshot
    players = sum(not kart.is_bot for kart in setup.karts)
    full_throttle = np.eye(1, len(CONTROLS), dtype=np.float32).repeat(players, 0)
    while snapshot.phase < Phase.GO_PHASE:
        snapshot = session.step(full_throttle)
    return replace(start, snapshot=snapshot)
