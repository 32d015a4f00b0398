"""Saved states: the whole state of a race as a value that you can restore any number of times."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from stkzoo._checks import check_type
from stkzoo.engine.session import Session, WorkerSession
from stkzoo.env.episode import Episode
from stkzoo.env.options import OF_AN_EPISODE, RaceOptions
from stkzoo.errors import ApiOrderError, ConfigError
from stkzoo.views.chains import ChainsMemory

if TYPE_CHECKING:
    from stkzoo.env.opponents import OpponentsMoment


@dataclass(frozen=True, slots=True)
class Moment:
    """Immutable state of an environment, without the state of the game.

    Attributes:
        episode: the race and its counters.
        agents: agents that are still racing.
        roster: karts and agents of the race, in words.
        random: the environment's random generator.
        memory: state of the agents' wrappers.
        opponents: state of the opponents, if there are any.
    """

    episode: Episode
    agents: tuple[str, ...]
    roster: str
    random: np.random.Generator
    memory: ChainsMemory
    opponents: OpponentsMoment | None = None


class RaceState:
    """A saved moment of a race: ``save_state`` returns it and ``restore_state`` accepts it.

    The state holds a paused copy of the game process. Every restore copies that process again, so
    you can restore a state any number of times, in the environment that saved it or in another one
    with the same agents, even after the first environment was closed. The state stays open until
    :meth:`close`, until it is garbage-collected or until the program ends. It cannot be pickled.

    Attributes:
        is_open: whether the state is still open.
        moment: state of the environment, without the state of the game.
        race: names of the race and its karts.
        snapshot: snapshot of all karts at the saved moment.
        agents: agents that were still racing.
        roster: karts and agents of the race, in words.
    """

    def __init__(self, session: Session, moment: Moment) -> None:
        if isinstance(session, WorkerSession):
            session.what = f"the process of a saved state ({moment.episode.race.track})"
            session.remedy = "the state is lost; save another"
        self._session = session
        self.moment = moment
        self.race, self.snapshot = moment.episode.race, moment.episode.snapshot
        self.agents, self.roster = moment.agents, moment.roster
        self.is_open = True
        self._lock = threading.RLock()  # a handler of a signal may close it

    @property
    def pid(self) -> int | None:
        """Id of the paused game process; ``None`` after it has ended."""
        return self._session.pid

    def resume_in(self, session: Session) -> None:
        """Continues a copy of the saved race in a session.

        Args:
            session: the session; its current race ends.

        Raises:
            ApiOrderError: the state was closed.
            EngineCrashed: its process was ended from outside.
            EngineTimeout: its process did not answer in time.
            EngineError: the session does not support saved states.
        """
        if not self.is_open:
            raise ApiOrderError("the state was closed; save another with save_state()")
        with self._lock:  # several threads may restore the same state
            session.resume(self._session)

    def close(self) -> None:
        """Ends the paused game process; you may call it more than once."""
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


def checked_state(state: object) -> RaceState:
    """Returns a saved state.

    Raises:
        ConfigError: it is something else.
    """
    checked: RaceState = check_type("state", state, RaceState, "a RaceState from save_state()")
    return checked


def check_beside(what: str, asked: Mapping[str, Any], agents: Sequence[str]) -> None:
    """Checks that an episode can start at the moment of a saved state or scenario.

    Args:
        what: ``"state"`` or ``"scenario"``.
        asked: all options of ``reset``.
        agents: agents that were racing at that moment.

    Raises:
        ApiOrderError: there are no agents.
        ConfigError: an option is about what the moment already determines.
    """
    allowed = {what, "num_kart", *OF_AN_EPISODE}
    both = ({*RaceOptions.__dataclass_fields__, "state"} - allowed) & set(asked)
    if both:
        raise ConfigError(
            f"options have a {what} and {', '.join(sorted(both))}, which the {what} already "
            "determines; leave out one of them"
        )
    if not agents:
        raise ApiOrderError(
            f"the {what} was saved after all agents had left, so no agent can act; use an earlier "
            f"{what}"
        )
