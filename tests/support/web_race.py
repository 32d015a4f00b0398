"""Helpers for tests of the live page: a watched race and a viewer."""

import asyncio
import contextlib
import json
import threading

import aiohttp

from stkzoo.race import run_race
from stkzoo.race.web import LivePage

PATIENCE = 20.0


class WatchedRace:
    """A race in a separate thread, with its live page."""

    def __init__(self, drivers=("ai", "random"), *, steps=100_000, track="olivermath", **options):
        self.page = LivePage(**{"port": 0, "paused": True, **options})
        self._turns = self.page.control._changed = _Turns()
        self.result = self.error = None
        self._drivers, self._settings = drivers, {"track": track, "max_steps": steps, "seed": 3}
        self._thread = threading.Thread(target=self._race)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.page.control.stop()
        self.join()

    def join(self):
        """Waits for the end of the race and returns the result."""
        self._thread.join(60)
        assert not self._thread.is_alive()
        if self.error is not None:
            raise self.error
        return self.result

    async def still(self):
        """Waits until the race waits in a pause; returns its number of steps."""
        control = self.page.control
        for _ in range(int(3 * PATIENCE / 0.01)):
            with self._turns:
                if self._turns.is_waiting and control.mode == "paused" and not control._steps:
                    return self.page._server.news.steps
            await asyncio.sleep(0.01)
        raise TimeoutError("the race does not pause")

    def _race(self):
        try:
            self.result = run_race(self._drivers, listeners=[self.page], **self._settings)
        except BaseException as error:  # noqa: BLE001 - the test raises it
            self.error = error

    def watch(self, scenario, viewers=1):
        """Runs ``await scenario(viewer, ...)`` and returns what it returns."""
        return asyncio.run(self._watch(scenario, viewers))

    async def _watch(self, scenario, viewers):
        async with contextlib.AsyncExitStack() as life:
            session = await life.enter_async_context(aiohttp.ClientSession())
            joined = [
                await life.enter_async_context(viewer(session, self.page.url))
                for _ in range(viewers)
            ]
            return await asyncio.wait_for(scenario(*joined), 3 * PATIENCE)


class _Turns(threading.Condition):
    """The condition of a race's control, which tells whether the race's thread waits."""

    is_waiting = False

    def wait(self, timeout=None):
        self.is_waiting = True
        try:
            return super().wait(timeout)
        finally:
            self.is_waiting = False


@contextlib.asynccontextmanager
async def viewer(session, url, **options):
    """Connects a viewer to a page. The options are those of ``ws_connect``, and ``key``."""
    address, key = url.split("#")[0], options.pop("key", "")
    async with session.ws_connect(
        f"{address}live", params={"version": "1", "key": key}, max_msg_size=0, **options
    ) as socket:
        yield Viewer(socket)


class Viewer:
    """A client of the live page's protocol."""

    def __init__(self, socket):
        self.socket = socket
        self.kinds = []

    async def send(self, kind, **fields):
        """Sends a message."""
        await self.socket.send_str(json.dumps({"type": kind, **fields}))

    async def next(self, kind, accept=lambda _: True):
        """Returns the next message of a kind that ``accept`` accepts."""
        while True:
            message = await self.socket.receive(timeout=PATIENCE)
            assert message.type == aiohttp.WSMsgType.TEXT, message
            form = json.loads(message.data)
            self.kinds.append(form["type"])
            if form["type"] == kind and accept(form):
                return form

    async def mode(self, mode):
        """Waits until the race is in a mode; returns the message."""
        return await self.next("state", lambda form: form["mode"] == mode)

    async def moment(self, steps):
        """Returns the first moment after at least ``steps`` steps."""
        return await self.next("moment", lambda form: form["steps"] >= steps)

    async def silence(self, seconds=0.4):
        """Asserts that the race does not advance."""
        assert await self._moments(seconds) == []

    async def _moments(self, seconds):
        """Returns the steps that arrive until none has arrived for ``seconds``."""
        steps = []
        with contextlib.suppress(asyncio.TimeoutError):
            while True:
                form = json.loads((await self.socket.receive(timeout=seconds)).data)
                steps += [form["steps"]] if form["type"] == "moment" else []
        return steps
