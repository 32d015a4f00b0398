"""One browser that shows the page: what it is sent, and what it may ask for."""

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

__all__ = ["PROTOCOL_VERSION", "Viewer"]

logger = logging.getLogger(__name__)

#: Of the messages; grows when a page of an older version would go wrong.
PROTOCOL_VERSION = 1

#: A viewer is sent at most so many moments a second, and observations.
_MOMENT_PAUSE, _OBSERVATION_PAUSE = 1 / 30, 1 / 5
#: Who takes nothing for so long is let go [s].
_PATIENCE = 20.0


class Viewer:
    """One connection. It is sent what is new whenever it has taken the last.

    A slow viewer leaves moments out; nobody waits for it.

    Args:
        socket: the connection.
        board: what there is to show.
        control: what it may steer.
        may_steer: whether it may.
    """

    def __init__(
        self,
        socket: web.WebSocketResponse,
        board: RaceFeed,
        control: RaceControl,
        *,
        may_steer: bool,
    ) -> None:
        self._socket, self._board, self._control = socket, board, control
        self._may_steer = may_steer
        self._sight = ViewerState()
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
        """There may be something new."""
        self._news.set()

    async def serve(self) -> None:
        """Sends and listens until the viewer leaves."""
        self._news.set()
        self._sender = asyncio.ensure_future(self._send())
        try:
            await self._listen()
        finally:
            self._sender.cancel()
            await asyncio.gather(self._sender, return_exceptions=True)

    async def leave(self) -> None:
        """Sends what is left, says goodbye and closes."""
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
            logger.debug("a viewer is let go: %r", error)
            await self._socket.close(code=WSCloseCode.TRY_AGAIN_LATER, drain=False)

    async def _put_news(self) -> None:
        loop = asyncio.get_running_loop()
        now = loop.time()
        is_time = self._leaving or now - self._observed_at >= _OBSERVATION_PAUSE
        if is_time:
            self._observed_at = now
        for text in self._board.news(self._sight, with_observation=is_time):
            await self._put(text)
        if not is_time and self._board.owes_observation(self._sight):
            loop.call_later(_OBSERVATION_PAUSE, self.wake)

    async def _put(self, text: str) -> None:
        await asyncio.wait_for(self._socket.send_str(text), _PATIENCE)

    # ------------------------------------------------------------------ from the viewer

    async def _listen(self) -> None:
        async for message in self._socket:
            if message.type == WSMsgType.ERROR:
                return
            try:
                self._obey(message)
            except (ProtocolError, ConfigError) as error:
                await self._put(encoded({"type": "error", "text": str(error)}))
                await self._socket.close(code=WSCloseCode.POLICY_VIOLATION)
                return

    def _obey(self, message: Any) -> None:
        form = _parsed(message)
        kind = form.get("type")
        if kind == "watch":
            self._watch(form.get("agent"))
        elif kind == "speed" or (isinstance(kind, str) and kind in self._commands):
            self._steer(kind, form)
        else:
            known = ", ".join(["speed", "watch", *self._commands])
            raise ProtocolError(f"a message of type {kind!r:.50}, expected one of {known}")

    def _watch(self, agent: object) -> None:
        if agent is not None and agent not in self._board.agents:
            raise ProtocolError(f"agent is {agent!r:.50}, expected an agent of this race or null")
        self._sight.watched = None if agent is None else str(agent)
        self._observed_at = 0.0
        self.wake()

    def _steer(self, kind: str, form: dict[str, Any]) -> None:
        if not self._may_steer:
            raise ProtocolError(
                "this viewer may only watch; to steer, open the address that was shown where the "
                "race was started, with its key"
            )
        if kind == "speed":
            value = form.get("value")
            if not (value is None or isinstance(value, (int, float))):
                raise ProtocolError(f"a speed of {value!r:.50}, expected 1, 2, 4 or null")
            self._control.set_speed(value)
        else:
            self._commands[kind]()


def _parsed(message: Any) -> dict[str, Any]:
    if message.type != WSMsgType.TEXT:
        raise ProtocolError("a binary message, expected JSON text")
    try:
        form = json.loads(message.data)
    except (ValueError, RecursionError) as error:
        raise ProtocolError("a message that is no JSON, expected an object") from error
    if not isinstance(form, dict):
        raise ProtocolError(f"a message that is a {type(form).__name__}, expected an object")
    return form
