"""An agent that a server runs for a client, in its own thread."""

from __future__ import annotations

import dataclasses
import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from queue import SimpleQueue

from stkzoo._logs import RepeatFilter
from stkzoo.drivers.driver import Driver
from stkzoo.drivers.failures import printable
from stkzoo.drivers.instances import DriverInstance, DriverLimits, DriverRequest
from stkzoo.drivers.messages import (
    Decided,
    Failed,
    Message,
    Ready,
    decode_observation,
    start_reply,
)
from stkzoo.mdp.spaces import kart_action_space, kart_observation_space
from stkzoo.race.remote.protocol import Acted, Open, Opened, Refused

logger = logging.getLogger(__name__)
logger.addFilter(RepeatFilter())

#: Held while an agent runs in this process, because its modules take the place of other agents'.
_in_process = threading.Lock()


class AgentSession(threading.Thread):
    """A thread that runs an agent for a client.

    The thread itself starts the agent, because some agents end with the thread that started them.

    Args:
        driver: the driver; not the game's AI.
        limits: resource limits of the agent.
        opening: the client's request.
        reply: sends a message to the client; ``None`` ends the session. The thread calls it.

    Attributes:
        client: the client.
        heard: time of the client's last message (:func:`time.monotonic`).
        is_busy: whether the thread has not replied to the client's last message.
    """

    def __init__(
        self,
        driver: Driver,
        limits: DriverLimits,
        opening: Open,
        reply: Callable[[Message | None], None],
    ) -> None:
        super().__init__(name="stkzoo-session", daemon=True)
        self._driver, self._reply = driver, reply
        self._request = _driver_request(opening, limits)
        self.client, self.heard, self.is_busy = opening.client, time.monotonic(), True
        self._inbox: SimpleQueue[bytes | None] = SimpleQueue()
        self._agent: DriverInstance | None = None

    def put(self, observation: bytes | None) -> None:
        """Gives the agent an encoded observation; ``None`` ends the thread."""
        self.is_busy = True
        self._inbox.put(observation)

    def run(self) -> None:
        """Serves the client until the end of the session or an error."""
        try:
            self._serve()
        except Exception:  # the server continues after any error
            logger.exception("a session failed")
            self._reply(Refused("the session is over: the server failed"))
        finally:
            self._reply(None)
            if self._agent is not None:
                with self._turn():
                    self._agent.close()

    def _serve(self) -> None:
        outcome = self._start()
        self._reply(Opened(outcome))
        is_usable = not isinstance(outcome, Failed)
        while is_usable and (observation := self._inbox.get()) is not None:
            acted = self._act(observation)
            self._reply(acted)
            is_usable = acted.is_usable

    def _start(self) -> Ready | Failed:
        assert self._driver.start is not None  # noqa: S101 - the server refuses the game's AI
        try:
            self._agent = self._driver.start(self._request)
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            return Failed.of(error)
        with self._turn():
            return start_reply(self._agent)

    def _act(self, observation: bytes) -> Acted:
        agent = self._agent
        assert agent is not None  # noqa: S101 - it is ready
        try:
            with self._turn():
                agent.ask(observation if self._is_isolated else decode_observation(observation))
                return Acted(Decided.of(agent.answer()), is_usable=True)
        except Exception as error:  # noqa: BLE001 - an agent may raise anything
            return Acted(Failed.of(error), bool(agent.is_usable))

    @property
    def _is_isolated(self) -> bool:
        """Whether another process runs the agent, and decodes its observations."""
        return getattr(self._agent, "takes_encoded", False)

    def _turn(self) -> AbstractContextManager[object]:
        """Returns a context in which the agent may run."""
        return nullcontext() if self._is_isolated else _in_process


def _driver_request(opening: Open, limits: DriverLimits) -> DriverRequest:
    action_timeout = opening.action_timeout
    if limits.action_timeout is not None:
        action_timeout = min(action_timeout or limits.action_timeout, limits.action_timeout)
    return DriverRequest(
        agent=printable(opening.agent),
        observation_space=kart_observation_space(extras=opening.extras),
        action_space=kart_action_space(),
        seed=opening.seed,
        limits=dataclasses.replace(
            limits,
            action_timeout=action_timeout,
            start_timeout=min(limits.start_timeout, opening.start_timeout),
        ),
    )
