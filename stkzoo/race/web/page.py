"""The live page, which shows a race in browsers."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from stkzoo._checks import check_whole
from stkzoo._imports import import_extra
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import RaceResult
from stkzoo.race.web import messages
from stkzoo.race.web.control import RaceControl


class LivePage(RaceListener):
    """Listener that shows its race on a page, from which viewers can control it.

    The page is available from the creation of the object until the end of the race. The race also
    runs without viewers, and a slow viewer does not delay it.

    Args:
        host: address to serve on. If other machines can reach it (``"0.0.0.0"``), anyone may watch,
            but only viewers with the key in :attr:`url` may control the race.
        port: port to serve on; 0 selects a free port.
        speed: speed as a multiple of real time: 1, 2 or 4; ``None`` for no limit.
        paused: whether to wait on the grid until a viewer starts the race.
        stay: keep the page after the race until a viewer stops it or Ctrl-C is pressed.

    Attributes:
        port: port of the page.
        url: address of the page, including the key for control if one is required.

    Raises:
        ConfigError: an argument is invalid, the port is taken, or aiohttp is not installed.
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 8000,
        speed: float | None = 1.0,
        paused: bool = False,
        stay: bool = False,
    ) -> None:
        check_whole("port", port, 0, 65535)
        import_extra("aiohttp", "the live page needs", "races")
        from stkzoo.race.web.server import LiveServer

        self.control = RaceControl(speed, paused=paused)
        self._server = LiveServer(host, port, self.control)
        self.port, self.url = self._server.port, self._server.url
        self._stay = stay

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        make_message = partial(messages.race_message, race.scene, race.sources, race.seed)
        self._server.news = messages.RaceNews(messages.text_of(make_message), tuple(race.names))
        self.control.begin()
        self._show(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._show(race)

    def ended(self, result: RaceResult) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.control.finish()
        message = messages.text_of(lambda: {"type": "result", "result": result.to_dict()})
        self._server.news = replace(self._server.news, result=message)
        if self._stay and result.status != "interrupted":
            try:
                self.control.wait_stop()
            except KeyboardInterrupt:
                return  # the result is already complete

    def closed(self) -> None:
        """Closes the page. Open browser windows keep the content that they have received."""
        self._server.close()

    def _show(self, race: RaceProgress) -> None:
        """Shows the state of a race and waits until its next step is due."""
        scene, snapshot, steps = race.scene, race.snapshot, race.steps
        totals = [0.0] * scene.num_kart
        for kart, total in zip(scene.kart_indices, race.total_rewards.values(), strict=True):
            totals[kart] = total
        controls = snapshot.karts["control"]
        traces = messages.trace_row(scene, snapshot, controls, totals)
        news = self._server.news
        news.traces.add(steps, traces)
        failures = {agent: all_[-1].message for agent, all_ in race.failures.items() if all_}

        def make_message() -> dict[str, Any]:
            message = messages.moment_message(scene, snapshot, steps, traces, controls)
            return {**message, "failures": failures}

        moment = messages.text_of(make_message)
        self._server.news = replace(news, moment=moment, steps=steps, details=_details(race))
        if not self.control.wait_turn(scene.setup.step_size):
            race.stop("stopped")


def _details(race: RaceProgress) -> dict[str, dict[str, Any]]:
    """Returns the values of each agent for the page's tree."""
    details: dict[str, dict[str, Any]] = {}
    for agent, info in race.infos.items():
        details[agent] = {
            "observation": race.observations.get(agent, {}),
            "action": race.actions.get(agent, {}),
            "info": info,
        }
        if agent in race.seconds:
            details[agent]["thinking"] = {"milliseconds": 1000 * race.seconds[agent]}
    return details
