"""Seeds of races, and a small set of starts to reuse: each race starts once, then is copied."""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from stkzoo.engine.fork_client import can_fork
from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import Session, WorkerSession
from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError, EngineError, check_whole
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
    return [own if own is None else check_whole("seed", own, 0) for own in seed]


class RepeatedStarts:
    """Draws the seeds of races from a small set, and keeps the races' starts to copy them.

    A start waits in its own process. A copy of it gives the same race as a new start.

    Args:
        count: number of seeds in the set, and maximum number of starts to keep.
        seed: seed of the set; ``None`` draws another set in each :meth:`reseed`.
        skips_countdown: whether starts wait at GO, with all karts at full throttle.

    Raises:
        ConfigError: races cannot be copied on this system.
    """

    def __init__(self, count: int, seed: int | None = None, skips_countdown: bool = False) -> None:
        if not can_fork():
            raise ConfigError(
                "num_starts needs races that can be copied, which is possible only on Linux "
                "without STKZOO_START_METHOD=spawn; leave num_starts out"
            )
        self._count, self._seed, self._skips_countdown = count, seed, skips_countdown
        self._kept: OrderedDict[RaceSetup, tuple[WorkerSession, RaceStart]] = OrderedDict()
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

    def begin(
        self, setup: RaceSetup, session: Session, new_session: Callable[[], WorkerSession]
    ) -> RaceStart:
        """Ends a session's race and begins another one in it.

        Args:
            setup: setup of the race.
            session: the session.
            new_session: makes a session in which a start can wait.

        Raises:
            ConfigError: the setup is invalid.
            EngineError: the game does not start.
        """
        if setup in self._kept:
            self._kept.move_to_end(setup)
            waiting, start = self._kept[setup]
            try:
                session.resume(waiting)
            except EngineError as error:
                logger.info("a start that waited was lost: %s", error)
                self._forget(setup)
            else:
                return start
        waiting = new_session()
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
        return start

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
