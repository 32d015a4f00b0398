"""A race whose successor can be started while it still runs."""

from __future__ import annotations

import copy
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gymnasium.utils import seeding

from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import WorkerSession
from stkzoo.engine.setup import RaceSetup
from stkzoo.env.grid import draw_race
from stkzoo.env.options import checked_seed
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.errors import ConfigError, EngineError

logger = logging.getLogger(__name__)


class AheadSession(WorkerSession):
    """Races in processes of their own, the next of which may be started ahead.

    Every race is the first of its process, so it makes no difference to a race whether
    it was started ahead.

    Args:
        root: the game's data.
        timeout: seconds that one step may take.
    """

    def __init__(self, root: Path, timeout: float) -> None:
        self._next: tuple[RaceSetup, WorkerSession] | None = None
        self._timeout = timeout
        super().__init__(root, timeout=timeout)

    @property
    def next_pid(self) -> int | None:
        """Process id of the race that waits to be started, if any."""
        return self._next[1].pid if self._next else None

    def prepare(self, setup: RaceSetup) -> None:
        """Starts a race beside the present one, and does not wait for it.

        :meth:`start` takes it if it asks for the same, else it is thrown away. A failure
        shows when :meth:`start` fails as well.
        """
        if self._next and self._next[0] == setup:
            return
        self._forget()
        session = WorkerSession(self._root, timeout=self._timeout)
        try:
            session.start_async(setup)
        except EngineError as error:
            logger.info("a race could not be started ahead: %s", error)
        else:
            self._next = setup, session

    def start(self, setup: RaceSetup) -> RaceStart:
        """See :meth:`stkzoo.engine.session.Session.start`."""
        (asked, session), self._next = self._next or (None, None), None
        if session is None:
            return super().start(setup)
        if asked == setup and session._owner == os.getpid():
            try:
                start = session.start_wait()
            except (ConfigError, EngineError) as error:
                logger.info("a race that was started ahead was lost: %s", error)
            else:
                self.close()
                self._process, session._process = session._process, None
                self._owner = session._owner
                return start
        session.close()
        return super().start(setup)

    def close(self) -> None:
        """See :meth:`stkzoo.engine.session.Session.close`."""
        self._forget()
        super().close()

    def _forget(self) -> None:
        ahead, self._next = self._next, None
        if ahead is not None:
            ahead[1].close()


class AheadRace(RaceParallelEnv):
    """A race with :meth:`prepare`; in all else the parallel environment.

    Args:
        **options: those of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Raises:
        ConfigError: an option is invalid, or not for a race that others run beside.
    """

    def __init__(self, **options: Any) -> None:
        for name, only in (("use_subprocess", True), ("render_mode", None)):
            if options.get(name, only) != only:
                raise ConfigError(
                    f"{name} is {options[name]!r}, but races side by side run in processes of "
                    f"their own without a window: leave {name} at {only}, or use one "
                    "race_v0.parallel_env"
                )
        super().__init__(**options)
        self._ahead = AheadSession(self._assets.root, float(options.get("engine_timeout", 30.0)))
        self._session = self._ahead

    def prepare(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Starts the race that :meth:`reset` with the same arguments will ask for.

        Returns at once. What ``reset`` draws and gives is the same with and without it.
        """
        options = {} if options is None else options
        now = self.options.changed(options)
        if "state" in options:
            return
        random = (
            copy.deepcopy(self.np_random)
            if seed is None
            else seeding.np_random(checked_seed(seed))[0]
        )
        tracks = now.tracks(self._assets.tracks)
        setup, _ = draw_race(now, self.specs, tracks, self._num_cameras, False, random)
        self._ahead.prepare(setup)
