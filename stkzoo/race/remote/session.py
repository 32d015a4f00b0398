"""One client's side of a server: its seats, in a thread of their own."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from stkzoo.errors import AgentError, AgentTimeout, ProtocolError
from stkzoo.race.codec import Encoded, decode, encode
from stkzoo.race.drivers import Driver
from stkzoo.race.instances import DriverInstance, DriverLimits, DriverRequest
from stkzoo.race.remote.protocol import (
    ACT,
    ACTED,
    CLOSE,
    ERROR,
    MAX_SEATS,
    OPEN,
    OPENED,
    pack,
    printable,
    take,
    take_version,
    unpack,
)
from stkzoo.race.remote.spaces import space_from_data

__all__ = ["Session"]

_log = logging.getLogger(__name__)

#: How much may wait for a session that is busy.
_MAX_WAITING_MESSAGES, _MAX_WAITING_BYTES = 128, 16 << 20

#: Sends a message (kind and body) to the session's client; an empty kind says it is over.
Reply = Callable[[bytes, bytes], None]


class Session(threading.Thread):
    """Seats of one client.

    The thread opens the seats, because some live as long as the thread that opened them.

    Args:
        drivers: who can be given a seat.
        limits: what each may use at most.
        replier: makes the way back to the client; called in the thread.
    """

    def __init__(
        self,
        drivers: Sequence[Driver],
        limits: DriverLimits,
        replier: Callable[[], contextlib.AbstractContextManager[Reply]],
    ) -> None:
        super().__init__(name="stkzoo-session", daemon=True)
        self._drivers, self._limits, self._replier = drivers, limits, replier
        self._inbox: deque[tuple[bytes, bytes]] = deque()
        self._waiting = 0
        self._changed = threading.Condition()
        self._is_ending = False
        self._seats: dict[int, DriverInstance] = {}
        self._starting: list[int] = []
        self._used: set[int] = set()

    def put(self, kind: bytes, body: bytes) -> bool:
        """Hands over a message from the client; ``False`` if too many wait already."""
        with self._changed:
            self._waiting += len(body)
            self._inbox.append((kind, body))
            self._changed.notify()
            return len(self._inbox) <= _MAX_WAITING_MESSAGES and self._waiting <= _MAX_WAITING_BYTES

    def end(self) -> None:
        """Lets the session end soon, whatever still waits."""
        with self._changed:
            self._is_ending = True
            self._inbox.clear()
            self._changed.notify()

    def run(self) -> None:
        """Serves until the client breaks the protocol, or :meth:`end`."""
        with self._replier() as self._reply:
            try:
                self._serve()
            except ProtocolError as error:
                self._reply(ERROR, pack(text=f"the session is over: {error}"))
            except Exception:  # noqa: BLE001 - whatever it was, the server goes on
                _log.exception("a session failed")
                self._reply(ERROR, pack(text="the session is over: the server made a mistake"))
            finally:
                self._reply(b"", b"")
                for seat in self._seats.values():
                    seat.close()

    def _serve(self) -> None:
        while (message := self._next()) is not None:
            kind, body = message
            if kind == OPEN:
                self._open(unpack(body))
            elif kind == ACT:
                self._make_ready()
                self._act(unpack(body))
            elif kind == CLOSE:
                self._close(take(unpack(body), "seats", list))
            else:
                raise ProtocolError(f"message kind {kind!r:.20} came, expected one of O, A, C")

    def _next(self) -> tuple[bytes, bytes] | None:
        """The next message; all drivers that are starting are waited for before waiting."""
        if not self._inbox:
            self._make_ready()
        with self._changed:
            self._changed.wait_for(lambda: self._is_ending or self._inbox)
            if self._is_ending:
                return None
            kind, body = self._inbox.popleft()
            self._waiting -= len(body)
            return kind, body

    # ------------------------------------------------------------------ seats

    def _open(self, fields: dict[str, Any]) -> None:
        """Lets a driver start; several start side by side."""
        take_version(fields)
        number, driver = take(fields, "seat", int), take(fields, "driver", int)
        if number in self._used or len(self._seats) >= MAX_SEATS or len(self._used) > 10_000:
            raise ProtocolError(f"seat {number} is taken, or there are too many ({MAX_SEATS})")
        if not 0 <= driver < len(self._drivers):
            raise ProtocolError(f"driver {driver}, expected 0 to {len(self._drivers) - 1}")
        request = self._request(fields)
        start = self._drivers[driver].start
        if start is None:
            raise ProtocolError(f"driver {driver} is the game's own AI, which has no seat")
        self._used.add(number)
        try:
            self._seats[number] = start(request)
            self._starting.append(number)
        except Exception as error:  # noqa: BLE001 - of anybody's code
            self._reply(OPENED, pack(seat=number, error=_failure(error)))

    def _request(self, fields: dict[str, Any]) -> DriverRequest:
        return DriverRequest(
            agent=printable(take(fields, "agent", str), 100),
            observation_space=space_from_data(fields.get("observation_space")),
            action_space=space_from_data(fields.get("action_space")),
            seed=take(fields, "seed", int),
            limits=dataclasses.replace(
                self._limits,
                action_timeout=_lower(self._limits.action_timeout, fields.get("action_timeout")),
                start_timeout=_lower(self._limits.start_timeout, fields.get("start_timeout"))
                or self._limits.start_timeout,
            ),
        )

    def _make_ready(self) -> None:
        starting, self._starting = self._starting, []
        for number in starting:
            seat = self._seats.get(number)
            if seat is None:
                continue
            try:
                name = printable(seat.ready(), 100)
            except Exception as error:  # noqa: BLE001 - of anybody's code
                self._drop(number)
                self._reply(OPENED, pack(seat=number, error=_failure(error)))
            else:
                paths = getattr(seat, "paths_used", None)
                self._reply(OPENED, pack(seat=number, name=name, paths_used=paths))

    def _close(self, numbers: list[Any]) -> None:
        for number in numbers:
            if type(number) is not int:
                raise ProtocolError(f"seat {number!r:.50}, expected a whole number")
            self._drop(number)

    def _drop(self, number: int) -> None:
        seat = self._seats.pop(number, None)
        if seat is not None:
            seat.close()

    # ------------------------------------------------------------------ a step

    def _act(self, fields: dict[str, Any]) -> None:
        """Asks all seats, then collects their decisions."""
        step = take(fields, "step", int)
        decisions: list[list[Any]] = []
        failures: list[list[Any]] = []
        asked: list[int] = []
        for entry in take(fields, "observations", list):
            number, data = _observation(entry)
            if number in asked:
                raise ProtocolError(f"seat {number} is asked twice")
            if self._attempt(number, failures, lambda seat, data=data: _ask(seat, data)):  # type: ignore[misc]
                asked.append(number)
        for number in asked:
            self._attempt(
                number,
                failures,
                lambda seat, number=number: decisions.append(_answer(number, seat)),  # type: ignore[misc]
            )
        self._reply(ACTED, pack(step=step, decisions=decisions, failures=failures))

    def _attempt(
        self, number: int, failures: list[list[Any]], deed: Callable[[DriverInstance], object]
    ) -> bool:
        """Whether it went well; if not, it is noted, and the seat is closed if it is of no use."""
        seat = self._seats.get(number)
        if seat is None:
            failures.append([number, ["error", "it has no seat here", ""], False])
            return False
        try:
            deed(seat)
        except Exception as error:  # noqa: BLE001 - of anybody's code
            is_usable = bool(seat.is_usable)
            if not is_usable:
                self._drop(number)
            failures.append([number, _failure(error), is_usable])
            return False
        return True


def _observation(entry: Any) -> tuple[int, bytes]:
    match entry:
        case [int(number), bytes(data)]:
            return number, data
    raise ProtocolError(f"{entry!r:.100} came, expected a seat and its observation")


def _ask(seat: DriverInstance, data: bytes) -> None:
    """Hands an observation over, undecoded if it goes on to another process."""
    seat.ask(Encoded(data) if getattr(seat, "takes_encoded", False) else decode(data))


def _answer(number: int, seat: DriverInstance) -> list[Any]:
    decision = seat.answer()
    return [number, encode(decision.action), float(decision.seconds)]


def _failure(error: Exception) -> list[str]:
    """What is told of a driver's failure: of which kind, what, and where in its code."""
    kind = "timeout" if isinstance(error, AgentTimeout) else "error"
    text = str(error) if isinstance(error, AgentError) else f"{type(error).__name__}: {error}"
    return [kind, printable(text), printable(getattr(error, "trace", ""))]


def _lower(own: float | None, asked: object) -> float | None:
    """The shorter of two times, of which either may be without limit."""
    if asked is None:
        return own
    if type(asked) not in (int, float) or not 0 < asked < 1e9:  # type: ignore[operator]
        raise ProtocolError(f"a timeout of {asked!r:.50}, expected seconds or nothing")
    return float(asked) if own is None else min(own, float(asked))  # type: ignore[arg-type]
