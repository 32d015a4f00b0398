"""A race whose next race can be started while it still runs."""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping
from typing import Any

from stkzoo.engine.race import RaceStart
from stkzoo.engine.session import WorkerSession
from stkzoo.engine.setup import RaceSetup
from stkzoo.env.grid import draw_race
from stkzoo.env.options import random_stream
from stkzoo.env.parallel import RaceParallelEnv
from stkzoo.env.vec.starts import RepeatedStarts
from stkzoo.errors import ConfigError, EngineError, StkzooError

logger = logging.getLogger(__name__)


class AheadRace(RaceParallelEnv):
    """The parallel environment with :meth:`prepare`.

    Every race is the first one in its process, so starting it early does not change it.

    Args:
        **options: options of :class:`~stkzoo.env.parallel.RaceParallelEnv`.

    Attributes:
        starts: starts to copy; ``None`` starts every race in the game.

    Raises:
        ConfigError: an option is invalid, or not supported in a vector environment.
    """

    def __init__(self, **options: Any) -> None:
        for name, only in (("use_subprocess", True), ("render_mode", None)):
            if options.get(name, only) != only:
                raise ConfigError(
                    f"{name} is {options[name]!r}, but parallel races run in their own "
                    f"processes without a window; leave {name} at {only}, or use a single "
                    "race_v0.parallel_env"
                )
        super().__init__(**options)
        self.starts: RepeatedStarts | None = None
        self._next: tuple[RaceSetup, WorkerSession] | None = None

    def check_options(self, options: Mapping[str, Any]) -> None:
        """Checks options of :meth:`reset`.

        Raises:
            ApiOrderError: no agent was racing any more at the moment of a state or scenario.
            ConfigError: an option is unknown or invalid.
        """
        self._options_now(options).tracks(self._assets.tracks)
        if options.get("scenario") is not None:
            scenario = self._checked_scenario(options["scenario"], options)
            self._drivers_in(scenario, copy.deepcopy(self.np_random))
        elif options.get("state") is not None:
            self._checked_first_state(options["state"], options)
        elif self._opponents is not None:
            self._opponents.check_difficulty(options.get("difficulty"))

    def prepare(self, seed: int | None = None, options: Mapping[str, Any] | None = None) -> None:
        """Starts the race for the next :meth:`reset` with the same arguments, and returns at once.

        The results of ``reset`` do not depend on this call. If it fails, ``reset`` starts the race
        itself and reports the error if that fails too. With ``starts``, or options with a state or
        a scenario, it does nothing.
        """
        options = {} if options is None else options
        now = self.options.changed(options)
        if self.starts is not None or not options.keys().isdisjoint(("state", "scenario")):
            return
        random = copy.deepcopy(self.np_random) if seed is None else random_stream(seed)
        now, _, specs = self._draw_opponents(now, options, random)
        tracks = now.tracks(self._assets.tracks)
        setup, _ = draw_race(now, self.specs, tracks, self._num_cameras, False, random, specs)
        if self._next and self._next[0] == setup:
            return
        self._forget_next()
        session = self._new_session()
        try:
            session.start_async(setup)
        except EngineError as error:
            logger.info("a race could not be started ahead: %s", error)
        else:
            self._next = setup, session

    def close(self) -> None:
        """See :meth:`~stkzoo.env.parallel.RaceParallelEnv.close`."""
        with self._turn.of("close"):
            self._forget_next()
            super().close()

    def _begin(self, setup: RaceSetup) -> RaceStart:
        """Returns the race that was started ahead if the setup matches, otherwise starts one."""
        if self.starts is not None:
            return self.starts.begin(setup, self._session, self._new_session)
        if self._next is None:
            return super()._begin(setup)
        asked, session = self._next
        if asked == setup:
            try:
                begun = session.start_wait()
            except StkzooError as error:
                logger.info("a race that was started ahead was lost: %s", error)
            else:
                self._session.close()
                self._session, self._next = session, None
                return begun
        self._forget_next()
        return super()._begin(setup)

    def _new_session(self) -> WorkerSession:
        arguments: dict[str, Any] = self._ezpickle_kwargs
        return WorkerSession(self._assets.root, timeout=float(arguments["engine_timeout"]))

    def _forget_next(self) -> None:
        if self._next is not None:
            self._next[1].close()
            self._next = None
