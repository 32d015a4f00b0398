"""A viewer of the page: the messages to one browser and the commands from it."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, Literal

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web

from stkzoo._checks import shortened
from stkzoo.errors import ConfigError, ProtocolError
from stkzoo.race.web.control import RaceControl
from stkzoo.race.web.messages import RaceNews, encoded, plain

logger = logging.getLogger(__name__)

#: Version of the messages. It increases with each change that breaks older pages.
PROTOCOL_VERSION = 1

#: Minimum time between two updates for a viewer, and between two observations [s].
_MOMENT_PAUSE, _OBSERVATION_PAUSE = 1 / 30, 1 / 5
#: Time limit for a viewer to receive a message; then it is disconnected [s].
_PATIENCE = 20.0
#: Maximum number of messages from a viewer per second; a person sends fewer.
_MOST_MESSAGES = 50


class Command(msgspec.Struct, forbid_unknown_fields=True):
    """A message from a viewer.

    Attributes:
        type: ``"watch"`` selects an agent, ``"speed"`` sets the speed, and the others are methods
            of :class:`RaceControl`.
        agent: agent whose observations the viewer gets; ``None`` for none.
        value: speed of the race; ``None`` for no limit.
    """

    type: Literal["watch", "run", "pause", "step", "stop", "speed"]
    agent: str | None = None
    value: float | None = None


_commands = msgspec.json.Decoder(Command)


class Viewer:
    """The connection to one viewer.

    It sends updates up to 30 times per second, each after the previous one has been sent. A slow
    viewer skips updates and does not delay the race or other viewers.

    Args:
        socket: WebSocket of the viewer.
        read_news: returns the current content of the page.
        control: control of the race.
        closing: event that is set when the page closes.
        may_steer: whether the viewer may control the race.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        read_news: Callable[[], RaceNews],
        control: RaceControl,
        closing: asyncio.Event,
        *,
        may_steer: bool,
    ) -> None:
        self._socket, self._read_news, self._control = socket, read_news, control
        self._closing, self._may_steer = closing, may_steer
        self._sent: dict[str, Any] = {}  # last message of each kind
        self._step = -1  # last step of the traces that the viewer has
        self._watched: str | None = None
        self._next_observation = 0.0
        self._second, self._num_messages = 0, 0  # messages from the viewer in this second

    async def serve(self) -> None:
        """Sends and receives until the viewer disconnects or the page closes."""
        sender = asyncio.ensure_future(self._send())
        try:
            with suppress(ConnectionError, asyncio.TimeoutError):  # disconnected or stalled
                await self._listen()
        finally:
            if not self._closing.is_set():
                sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)

    # ------------------------------------------------------------------ to the viewer

    async def _send(self) -> None:
        hello = {"type": "hello", "version": PROTOCOL_VERSION, "may_steer": self._may_steer}
        try:
            await self._put(encoded(hello))
            while not self._closing.is_set():
                await self._put_news()
                await asyncio.sleep(_MOMENT_PAUSE)
            await self._put_news()
            await self._put(encoded({"type": "bye"}))
            await self._socket.close(code=WSCloseCode.GOING_AWAY)
        except (ConnectionError, asyncio.TimeoutError, RuntimeError) as error:
            logger.debug("a viewer is disconnected: %r", error)
            await self._socket.close(code=WSCloseCode.TRY_AGAIN_LATER, drain=False)

    async def _put_news(self) -> None:
        for text in self._texts(self._read_news()):
            await self._put(text)

    def _texts(self, news: RaceNews) -> Iterator[str]:
        """Yields the messages that the viewer does not have yet."""
        if self._is_new("race", news.race):
            self._step = -1
            yield self._sent["race"]()
        if self._is_new("state", state := {"type": "state", **self._control.state}):
            yield encoded(state)
        if self._is_new("moment", news.moment):
            past = news.traces.since(self._step)
            if past["steps"]:
                self._step = past["steps"][-1]
                yield encoded({"type": "traces", **past})
            yield self._sent["moment"]()
        if self._is_new("result", news.result):
            yield self._sent["result"]()
        details, now = news.details.get(self._watched or ""), time.monotonic()
        is_time = now >= self._next_observation or self._closing.is_set()
        if details and is_time and self._is_new("observation", (self._watched, news.moment)):
            self._next_observation = now + _OBSERVATION_PAUSE
            message = {"agent": self._watched, "steps": news.steps, "parts": plain(details)}
            yield encoded({"type": "observation", **message})

    def _is_new(self, message_type: str, message: object) -> bool:
        before, self._sent[message_type] = self._sent.get(message_type), message
        return message is not None and message != before

    async def _put(self, text: str) -> None:
        await asyncio.wait_for(self._socket.send_str(text), _PATIENCE)

    # ------------------------------------------------------------------ from the viewer

    async def _listen(self) -> None:
        async for message in self._socket:
            if message.type == WSMsgType.ERROR:
                return
            try:
                self._count()
                if message.type == WSMsgType.PING:
                    await asyncio.wait_for(self._socket.pong(message.data), _PATIENCE)
                elif message.type != WSMsgType.PONG:
                    self._execute(message)
            except (ProtocolError, ConfigError) as error:
                await self._put(encoded({"type": "error", "text": str(error)}))
                await self._socket.close(code=WSCloseCode.POLICY_VIOLATION)
                return

    def _count(self) -> None:
        second = int(time.monotonic())
        self._num_messages = self._num_messages + 1 if second == self._second else 1
        self._second = second
        if self._num_messages > _MOST_MESSAGES:
            raise ProtocolError(f"too many messages, expected at most {_MOST_MESSAGES} in a second")

    def _execute(self, message: Any) -> None:
        if message.type != WSMsgType.TEXT:
            raise ProtocolError("a binary message came, expected JSON text")
        try:
            command = _commands.decode(message.data)
        except (msgspec.MsgspecError, RecursionError) as error:
            raise ProtocolError(f"an invalid message came, expected a command: {error}") from error
        if command.type == "watch":
            self._watch(command.agent)
        elif not self._may_steer:
            raise ProtocolError(
                "this viewer may only watch, expected the key in its address; open the address "
                "that was shown where the race was started"
            )
        elif command.type == "speed":
            self._control.set_speed(command.value)
        else:
            getattr(self._control, command.type)()

    def _watch(self, agent: str | None) -> None:
        if agent is not None and agent not in self._read_news().agents:
            raise ProtocolError(
                f"agent is {shortened(agent, 50)}, expected an agent of this race or null"
            )
        self._watched = agent
        self._next_observation = 0.0
