"""A client's session on a server: its agents, which run in their own thread."""

from __future__ import annotations

import dataclasses
import logging
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from queue import SimpleQueue

from stkzoo._logs import RepeatFilter
from stkzoo.drivers import messages
from stkzoo.drivers.driver import Driver
from stkzoo.drivers.failures import printable
from stkzoo.drivers.instances import DriverInstance, DriverLimits, DriverRequest
from stkzoo.errors import ProtocolError
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.race.remote import protocol

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

#: Limit of a session's queue of unprocessed messages [bytes], and overhead of each message [bytes].
_MAX_WAITING, _OVERHEAD = 16 << 20, 1 << 10
#: Maximum number of agents that a session starts one after another, such as restarted ones.
_MAX_STARTS = 10_000

#: Sends a message to the client; ``None`` ends the session.
Reply = Callable[[messages.Message | None], None]


class ClientSession(threading.Thread):
    """A thread that runs the agents of one client.

    The thread itself starts the agents, because some of them end with the thread that started
    them.

    Args:
        drivers: drivers that the client can use.
        limits: resource limits of each agent.
        replier: creates the function that sends to the client; called in the session's thread.

    Attributes:
        heard: time of the last message from the client (:func:`time.monotonic`).
        pinged: time of the last message to the client (:func:`time.monotonic`).
    """

    def __init__(
        self,
        drivers: Sequence[Driver],
        limits: DriverLimits,
        replier: Callable[[], AbstractContextManager[Reply]],
    ) -> None:
        super().__init__(name="stkzoo-session", daemon=True)
        self._drivers, self._limits, self._replier = drivers, limits, replier
        self.heard = self.pinged = time.monotonic()
        self._inbox: SimpleQueue[tuple[protocol.ClientMessage | None, int]] = SimpleQueue()
        self._num_put = self._num_taken = 0  # sizes of messages [bytes]
        self._is_ending = False
        self._agents: dict[int, DriverInstance] = {}
        self._starting: list[int] = []
        self._used: set[int] = set()

    def put(self, message: protocol.ClientMessage, size: int) -> bool:
        """Queues a message from the client and returns whether the queue is within its limit.

        Args:
            message: the message.
            size: its encoded size [bytes].
        """
        self._num_put += size + _OVERHEAD
        self._inbox.put((message, size + _OVERHEAD))
        return self._num_put - self._num_taken <= _MAX_WAITING

    def end(self) -> None:
        """Requests the end of the session and discards its queued messages."""
        self._is_ending = True
        self._inbox.put((None, 0))

    def run(self) -> None:
        """Serves the client until :meth:`end` is called or an error ends the session."""
        with self._replier() as self._reply:
            try:
                self._serve()
            except ProtocolError as error:
                self._reply(protocol.Refused(f"the session is over: {error}"))
            except Exception:  # the server continues after any error
                logger.exception("a session failed")
                self._reply(protocol.Refused("the session is over: the server failed"))
            finally:
                self._reply(None)
                for agent in self._agents.values():
                    agent.close()

    def _serve(self) -> None:
        while (message := self._next()) is not None:
            match message:
                case protocol.Open():
                    self._open(message)
                case protocol.Act():
                    self._make_ready()
                    self._act(message)
                case protocol.Close(seat):
                    self._drop(seat)

    def _next(self) -> protocol.ClientMessage | None:
        """Returns the next message, or ``None`` at the end of the session.

        If no message is queued, it first waits for the agents that are starting.
        """
        if self._inbox.empty():
            self._make_ready()
        message, size = self._inbox.get()
        self._num_taken += size
        return None if self._is_ending else message

    # ------------------------------------------------------------------ agents

    def _open(self, request: protocol.Open) -> None:
        """Starts an agent without waiting, so that several agents start in parallel."""
        seat = request.seat
        is_full = len(self._agents) >= protocol.MAX_SEATS or len(self._used) >= _MAX_STARTS
        if seat in self._used or is_full:
            raise ProtocolError(
                f"seat {seat} is taken, or there are too many ({protocol.MAX_SEATS})"
            )
        if request.driver >= len(self._drivers):
            raise ProtocolError(f"driver {request.driver}, expected 0 to {len(self._drivers) - 1}")
        start = self._drivers[request.driver].start
        assert start is not None  # noqa: S101 - the server refuses the game's AI
        self._used.add(seat)
        try:
            self._agents[seat] = start(self._request(request))
            self._starting.append(seat)
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            self._reply(protocol.Opened(seat, messages.Failed.of(error)))

    def _request(self, request: protocol.Open) -> DriverRequest:
        limits, action_timeout = self._limits, request.action_timeout
        if limits.action_timeout is not None:
            action_timeout = min(action_timeout or limits.action_timeout, limits.action_timeout)
        return DriverRequest(
            agent=printable(request.agent),
            observation_space=kart_observation_space(extras=request.extras),
            action_space=kart_action_space(),
            seed=request.seed,
            limits=dataclasses.replace(
                limits,
                action_timeout=action_timeout,
                start_timeout=min(limits.start_timeout, request.start_timeout),
            ),
        )

    def _make_ready(self) -> None:
        """Waits for the agents that are starting and reports the outcome of each start."""
        starting, self._starting = self._starting, []
        for seat in starting:
            agent = self._agents.get(seat)
            if agent is None:
                continue
            outcome = messages.start_reply(agent)
            if isinstance(outcome, messages.Failed):
                self._drop(seat)
            self._reply(protocol.Opened(seat, outcome))

    def _drop(self, seat: int) -> None:
        agent = self._agents.pop(seat, None)
        if agent is not None:
            agent.close()

    # ------------------------------------------------------------------ a step

    def _act(self, request: protocol.Act) -> None:
        """Sends observations to all agents, then collects and sends their decisions."""
        seats = [seat for seat, _ in request.observations]
        if len(set(seats)) < len(seats):
            raise ProtocolError("a seat is requested twice")
        failures = [self._ask(seat, data) for seat, data in request.observations]
        answers = [
            failure or self._answer(seat) for seat, failure in zip(seats, failures, strict=True)
        ]
        self._reply(protocol.Acted(request.step, answers))

    def _ask(self, seat: int, observation: bytes) -> protocol.Answer | None:
        """Sends an observation to an agent; returns the failure if there is one."""
        agent = self._agents.get(seat)
        if agent is None:
            failed = messages.Failed("error", "there is no agent in this seat", "")
            return protocol.Answer(seat, failed, 0.0, is_usable=False)
        takes_encoded = getattr(agent, "takes_encoded", False)  # another process decodes it
        try:
            agent.ask(observation if takes_encoded else messages.decode_observation(observation))
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            return self._failed(seat, error)
        return None

    def _answer(self, seat: int) -> protocol.Answer:
        try:
            decision = self._agents[seat].answer()
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            return self._failed(seat, error)
        return protocol.Answer(
            seat, messages.Decided.of(decision), float(decision.seconds), is_usable=True
        )

    def _failed(self, seat: int, error: Exception) -> protocol.Answer:
        """Returns the answer of an agent that failed, and closes it if it is no longer usable."""
        is_usable = bool(self._agents[seat].is_usable)
        if not is_usable:
            self._drop(seat)
        return protocol.Answer(seat, messages.Failed.of(error), 0.0, is_usable)
