"""One browser that shows the page: the messages to it and its commands."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from stkzoo.errors import ConfigError, ProtocolError
from stkzoo.race.web.control import RaceControl
from stkzoo.race.web.feed import RaceFeed, ViewerState
from stkzoo.race.web.messages import encoded

logger = logging.getLogger(__name__)

#: Version of the messages; grows when a page of an older version would fail.
PROTOCOL_VERSION = 1

#: Shortest time between two moments for a viewer, and between two observations [s].
_MOMENT_PAUSE, _OBSERVATION_PAUSE = 1 / 30, 1 / 5
#: A viewer that receives nothing for this time is disconnected [s].
_PATIENCE = 20.0


class Viewer:
    """One connection. It gets the news whenever it has received the last.

    A slow viewer misses moments; nothing waits for it.

    Args:
        socket: the connection.
        feed: the messages to show.
        control: the control of the race.
        may_steer: whether the viewer may control the race.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        feed: RaceFeed,
        control: RaceControl,
        *,
        may_steer: bool,
    ) -> None:
        self._socket, self._feed, self._control = socket, feed, control
        self._may_steer = may_steer
        self._state = ViewerState()
        self._news = asyncio.Event()
        self._leaving = False
        self._observed_at = 0.0
        self._sender: asyncio.Task[None] | None = None
        self._commands: dict[str, Callable[[], None]] = {
            "run": control.run,
            "pause": control.pause,
            "step": control.step,
            "stop": control.stop,
        }

    def wake(self) -> None:
        """Makes the sender look for news."""
        self._news.set()

    async def serve(self) -> None:
        """Sends and receives until the viewer leaves."""
        self._news.set()
        self._sender = asyncio.ensure_future(self._send())
        try:
            await self._listen()
        finally:
            self._sender.cancel()
            await asyncio.gather(self._sender, return_exceptions=True)

    async def leave(self) -> None:
        """Sends the last messages and closes."""
        self._leaving = True
        self._news.set()
        if self._sender is not None:
            await asyncio.gather(self._sender, return_exceptions=True)
        await self._socket.close(code=WSCloseCode.GOING_AWAY)

    # ------------------------------------------------------------------ to the viewer

    async def _send(self) -> None:
        hello = {"type": "hello", "version": PROTOCOL_VERSION, "may_steer": self._may_steer}
        try:
            await self._put(encoded(hello))
            while not self._leaving:
                await self._news.wait()
                self._news.clear()
                await self._put_news()
                await asyncio.sleep(0 if self._leaving else _MOMENT_PAUSE)
            await self._put_news()
            await self._put(encoded({"type": "bye"}))
        except (ConnectionError, asyncio.TimeoutError, RuntimeError) as error:
            logger.debug("a viewer is disconnected: %r", error)
            await self._socket.close(code=WSCloseCode.TRY_AGAIN_LATER, drain=False)

    async def _put_news(self) -> None:
        loop = asyncio.get_running_loop()
        now = loop.time()
        is_time = self._leaving or now - self._observed_at >= _OBSERVATION_PAUSE
        if is_time:
            self._observed_at = now
        for text in self._feed.news(self._state, with_observation=is_time):
            await self._put(text)
        if not is_time and self._feed.owes_observation(self._state):
            loop.call_later(_OBSERVATION_PAUSE, self.wake)

    async def _put(self, text: str) -> None:
        await asyncio.wait_for(self._socket.send_str(text), _PATIENCE)

    # ------------------------------------------------------------------ from the viewer

    async def _listen(self) -> None:
        async for message in self._socket:
            if message.type == WSMsgType.ERROR:
                return
            try:
                self._execute(message)
            except (ProtocolError, ConfigError) as error:
                await self._put(encoded({"type": "error", "text": str(error)}))
                await self._socket.close(code=WSCloseCode.POLICY_VIOLATION)
                return

    def _execute(self, message: Any) -> None:
        command = _parsed(message)
        kind = command.get("type")
        if kind == "watch":
            self._watch(command.get("agent"))
        elif kind == "speed" or (isinstance(kind, str) and kind in self._commands):
            self._steer(kind, command)
        else:
            known = ", ".join(["speed", "watch", *self._commands])
            raise ProtocolError(f"a message of type {kind!r:.50}, expected one of {known}")

    def _watch(self, agent: object) -> None:
        if agent is not None and agent not in self._feed.agents:
            raise ProtocolError(f"agent is {agent!r:.50}, expected an agent of this race or null")
        self._state.watched = None if agent is None else str(agent)
        self._observed_at = 0.0
        self.wake()

    def _steer(self, kind: str, command: dict[str, Any]) -> None:
        if not self._may_steer:
            raise ProtocolError(
                "this viewer may only watch; to control the race, open the address with the key "
                "that was shown where the race was started"
            )
        if kind == "speed":
            value = command.get("value")
            if not (value is None or isinstance(value, (int, float))):
                raise ProtocolError(f"a speed of {value!r:.50}, expected 1, 2, 4 or null")
            self._control.set_speed(value)
        else:
            self._commands[kind]()


def _parsed(message: Any) -> dict[str, Any]:
    if message.type != WSMsgType.TEXT:
        raise ProtocolError("a binary message, expected JSON text")
    try:
        command = json.loads(message.data)
    except (ValueError, RecursionError) as error:
        raise ProtocolError("a message that is not JSON, expected an object") from error
    if not isinstance(command, dict):
        raise ProtocolError(f"a message that is a {type(command).__name__}, expected an object")
    return command
