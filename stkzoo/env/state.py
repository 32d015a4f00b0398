"""A race's whole state as a value: saved once, gone on from as often as you like."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from stkzoo.engine.session import Session, WorkerSession
from stkzoo.engine.snapshot import Snapshot
from stkzoo.env.episode import Episode
from stkzoo.env.grid import RaceInfo, RaceRoster
from stkzoo.errors import ApiOrderError
from stkzoo.views.chains import ChainsMemory

if TYPE_CHECKING:
    from stkzoo.env.opponents import OpponentsMoment


@dataclass(frozen=True, slots=True)
class Moment:
    """What an environment knows beside the game, at one moment; nobody changes it.

    Attributes:
        episode: the race and its counts.
        agents: who is still racing.
        roster: who races.
        random: the environment's random stream.
        memory: what the agents' wrappers remember.
        opponents: the opponents, if there are any.
    """

    episode: Episode
    agents: tuple[str, ...]
    roster: RaceRoster
    random: np.random.Generator
    memory: ChainsMemory
    opponents: OpponentsMoment | None = None


class RaceState:
    """One moment of a race, kept: what ``save_state`` gives and ``restore_state`` takes.

    The game itself stands still in a process of its own, a copy of the race's at that
    moment, which every restoring copies again; so a state can be restored many times, in
    the environment that saved it or in others with equal agents, also when that one has
    been closed. It lives until :meth:`close`, or until nobody refers to it any more, or
    until the program ends; it cannot be pickled.

    Attributes:
        front: what the environment around the core remembers, if there is one.
        is_open: whether the state has not been closed.
        moment: what the environment knew beside the game.
    """

    def __init__(self, session: Session, moment: Moment) -> None:
        if isinstance(session, WorkerSession):
            session.what = f"the process of a saved state ({moment.episode.race.track})"
            session.remedy = "the state is lost; save another"
        self.front: Any = None
        self._session = session
        self.moment = moment
        self.is_open = True
        self._lock = threading.RLock()  # a handler of a signal may close it

    @property
    def pid(self) -> int | None:
        """Id of the process that keeps the game; ``None`` once it has ended."""
        return self._session.pid if isinstance(self._session, WorkerSession) else None

    @property
    def race(self) -> RaceInfo:
        """Names of the race and its karts."""
        return self.moment.episode.race

    @property
    def agents(self) -> tuple[str, ...]:
        """The agents that were still racing."""
        return self.moment.agents

    @property
    def snapshot(self) -> Snapshot:
        """The moment as the game told it."""
        return self.moment.episode.snapshot

    def resume_in(self, session: Session) -> None:
        """Makes a session go on with a copy of the saved race.

        Raises:
            ApiOrderError: the state was closed.
            EngineCrashed: its process was ended from outside.
            EngineTimeout: its process gave no answer in time.
            EngineError: the session's races cannot be saved and copied.
        """
        if not self.is_open:
            raise ApiOrderError("the state was closed; save another with save_state()")
        with self._lock:  # environments in several threads may restore one state
            session.resume(self._session)

    def close(self) -> None:
        """Ends the process that keeps the game; may be called again."""
        self.is_open = False
        with self._lock:
            self._session.close()

    def __enter__(self) -> RaceState:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "a RaceState belongs to the program that saved it and cannot be pickled or copied; "
            "restore it here, with restore_state() or reset(options={'state': ...})"
        )

    def __repr__(self) -> str:
        is_open = "" if self.is_open else ", closed"
        time = float(self.snapshot.header["time"])
        return f"<RaceState of {self.race.track!r} at {time:.2f} s{is_open}>"
