"""A client's session on a server: its driver instances, which run in their own thread."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from stkzoo._logs import RepeatFilter
from stkzoo.drivers.codec import Encoded, decode, encode
from stkzoo.drivers.driver import Driver
from stkzoo.drivers.failures import error_report, printable
from stkzoo.drivers.instances import DriverInstance, DriverLimits, DriverRequest
from stkzoo.errors import AgentError, ProtocolError, shortened
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.race.remote import protocol

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

#: Time after which the server pings a silent client [s]. Further pings become less frequent,
#: because a paused race does not read them and its queue must not overflow.
_PING = 2.0
#: Limits of a session's queue of unprocessed messages.
_MAX_WAITING_MESSAGES, _MAX_WAITING_BYTES = 128, 16 << 20

#: Maximum size of an action [bytes]. The actions of all seats take at most half of a message.
_MAX_ACTION_BYTES = protocol.LIMITS.max_bytes // (2 * protocol.MAX_SEATS)

#: Sends a message (kind and body) to the session's client; an empty kind ends the session.
Reply = Callable[[bytes, bytes], None]


class ClientSession(threading.Thread):
    """A thread that runs the driver instances of one client.

    The thread itself starts the instances, because some of them end with the thread that started
    them.

    Args:
        drivers: drivers that the client can use.
        limits: resource limits of each instance.
        replier: creates the function that sends to the client; called in the session's thread.

    Attributes:
        heard: time of the last message from the client (:func:`time.monotonic`).
        pinged: time of the last message to the client (:func:`time.monotonic`).
    """

    def __init__(
        self,
        drivers: Sequence[Driver],
        limits: DriverLimits,
        replier: Callable[[], contextlib.AbstractContextManager[Reply]],
    ) -> None:
        super().__init__(name="stkzoo-session", daemon=True)
        self._drivers, self._limits, self._replier = drivers, limits, replier
        self.heard = self.pinged = time.monotonic()
        self._inbox: deque[tuple[bytes, bytes]] = deque()
        self._waiting = 0
        self._changed = threading.Condition()
        self._is_ending = False
        self._instances: dict[int, DriverInstance] = {}
        self._starting: list[int] = []
        self._used: set[int] = set()

    def needs_ping(self, now: float) -> bool:
        """Returns whether a ping is due, which checks that the client is still connected."""
        return now - max(self.pinged, self.heard) > max(_PING, (now - self.heard) / 3)

    def put(self, kind: bytes, body: bytes) -> bool:
        """Queues a message from the client and returns whether the queue is within its limits."""
        with self._changed:
            self._waiting += len(body)
            self._inbox.append((kind, body))
            self._changed.notify()
            return len(self._inbox) <= _MAX_WAITING_MESSAGES and self._waiting <= _MAX_WAITING_BYTES

    def end(self) -> None:
        """Requests the end of the session and discards its queued messages."""
        with self._changed:
            self._is_ending = True
            self._inbox.clear()
            self._changed.notify()

    def run(self) -> None:
        """Serves the client until :meth:`end` is called or an error ends the session."""
        with self._replier() as self._reply:
            try:
                self._serve()
            except ProtocolError as error:
                self._send(protocol.ERROR, text=f"the session is over: {error}")
            except Exception:  # the server continues after any error
                logger.exception("a session failed")
                self._send(protocol.ERROR, text="the session is over: the server failed")
            finally:
                self._reply(b"", b"")
                for instance in self._instances.values():
                    instance.close()

    def _serve(self) -> None:
        while (message := self._next()) is not None:
            kind, body = message
            if kind == protocol.OPEN:
                self._open(protocol.unpack(body))
            elif kind == protocol.ACT:
                self._make_ready()
                self._act(protocol.unpack(body))
            elif kind == protocol.CLOSE:
                self._close(protocol.field(protocol.unpack(body), "seats", list))
            else:
                raise ProtocolError(
                    f"message kind {shortened(kind, 20)} came, expected one of O, A, C"
                )

    def _next(self) -> tuple[bytes, bytes] | None:
        """Returns the next message, or ``None`` at the end of the session.

        If no message is queued, it first waits for the drivers that are starting.
        """
        if not self._inbox:
            self._make_ready()
        with self._changed:
            self._changed.wait_for(lambda: self._is_ending or self._inbox)
            if self._is_ending:
                return None
            kind, body = self._inbox.popleft()
            self._waiting -= len(body)
            return kind, body

    def _send(self, kind: bytes, **fields: Any) -> None:
        self._reply(kind, protocol.pack(**fields))

    # ------------------------------------------------------------------ driver instances

    def _open(self, fields: dict[str, Any]) -> None:
        """Starts a driver without waiting, so that several drivers start in parallel."""
        protocol.check_version(fields)
        seat, driver = protocol.field(fields, "seat", int), protocol.field(fields, "driver", int)
        is_full = len(self._instances) >= protocol.MAX_SEATS or len(self._used) > 10_000
        if seat in self._used or is_full:
            raise ProtocolError(
                f"seat {seat} is taken, or there are too many ({protocol.MAX_SEATS})"
            )
        if not 0 <= driver < len(self._drivers):
            raise ProtocolError(f"driver {driver}, expected 0 to {len(self._drivers) - 1}")
        request = self._request(fields)
        start = self._drivers[driver].start
        if start is None:
            raise ProtocolError(f"driver {driver} is the game's own AI")
        self._used.add(seat)
        try:
            self._instances[seat] = start(request)
            self._starting.append(seat)
        except Exception as error:  # noqa: BLE001 - a driver may raise anything
            self._send(protocol.OPENED, seat=seat, error=error_report(error))

    def _request(self, fields: dict[str, Any]) -> DriverRequest:
        extras = protocol.check_extras(protocol.field(fields, "extras", list))
        return DriverRequest(
            agent=printable(protocol.field(fields, "agent", str), 100),
            observation_space=kart_observation_space(extras=extras),
            action_space=kart_action_space(),
            seed=protocol.field(fields, "seed", int),
            limits=dataclasses.replace(
                self._limits,
                action_timeout=_shorter(self._limits.action_timeout, fields.get("action_timeout")),
                start_timeout=_shorter(self._limits.start_timeout, fields.get("start_timeout"))
                or self._limits.start_timeout,
            ),
        )

    def _make_ready(self) -> None:
        """Waits for the drivers that are starting and reports the outcome of each start."""
        starting, self._starting = self._starting, []
        for seat in starting:
            instance = self._instances.get(seat)
            if instance is None:
                continue
            try:
                name = printable(instance.ready(), 100)
            except Exception as error:  # noqa: BLE001 - a driver may raise anything
                self._drop(seat)
                self._send(protocol.OPENED, seat=seat, error=error_report(error))
            else:
                paths = getattr(instance, "paths_used", None)
                self._send(protocol.OPENED, seat=seat, name=name, paths_used=paths)

    def _close(self, seats: list[Any]) -> None:
        for seat in seats:
            if type(seat) is not int:
                raise ProtocolError(f"seat {shortened(seat, 50)}, expected a whole number")
            self._drop(seat)

    def _drop(self, seat: int) -> None:
        instance = self._instances.pop(seat, None)
        if instance is not None:
            instance.close()

    # ------------------------------------------------------------------ a step

    def _act(self, fields: dict[str, Any]) -> None:
        """Sends observations to all drivers, then collects and sends their decisions."""
        step = protocol.field(fields, "step", int)
        observations = dict(map(_observation, protocol.field(fields, "observations", list)))
        if len(observations) < len(fields["observations"]):
            raise ProtocolError("a seat is requested twice")
        failures: list[list[Any]] = []
        asked = [s for s, data in observations.items() if self._attempt(s, failures, _ask, data)]
        answers = [self._attempt(seat, failures, _answer) for seat in asked]
        decisions = [[seat, *answer] for seat, answer in zip(asked, answers, strict=True) if answer]
        self._send(protocol.ACTED, step=step, decisions=decisions, failures=failures)

    def _attempt(
        self, seat: int, failures: list[list[Any]], function: Callable[..., Any], *arguments: Any
    ) -> Any:
        """Calls a function of a driver instance.

        If the call fails, it records the failure, closes an instance that is no longer usable, and
        returns ``None``.
        """
        instance = self._instances.get(seat)
        if instance is None:
            failures.append([seat, ["error", "there is no driver in this seat", ""], False])
            return None
        try:
            return function(instance, *arguments)
        except Exception as error:  # noqa: BLE001 - a driver may raise anything
            is_usable = bool(instance.is_usable)
            if not is_usable:
                self._drop(seat)
            failures.append([seat, error_report(error), is_usable])
            return None


def _observation(entry: Any) -> tuple[int, bytes]:
    match entry:
        case [int(seat), bytes(data)]:
            return seat, data
    raise ProtocolError(f"got {shortened(entry, 100)}, expected a seat and its observation")


def _ask(instance: DriverInstance, data: bytes) -> bool:
    """Sends an observation to an instance; does not decode it if another process will."""
    instance.ask(Encoded(data) if getattr(instance, "takes_encoded", False) else decode(data))
    return True


def _answer(instance: DriverInstance) -> tuple[bytes, float, bool]:
    decision = instance.answer()
    action = encode(decision.action)
    if len(action) > _MAX_ACTION_BYTES:
        raise AgentError(
            f"its action has {len(action)} bytes, expected at most {_MAX_ACTION_BYTES}; return an "
            "element of the action space",
            seconds=decision.seconds,
        )
    return action, float(decision.seconds), decision.is_clipped


def _shorter(own: float | None, requested: object) -> float | None:
    """Returns the shorter of two time limits [s]; ``None`` means no limit.

    Raises:
        ProtocolError: the requested limit is invalid.
    """
    if requested is None:
        return own
    if not isinstance(requested, (int, float)) or not 0 < requested < 1e9:
        raise ProtocolError(f"a timeout of {shortened(requested, 50)}, expected seconds or null")
    return float(requested) if own is None else min(own, float(requested))
