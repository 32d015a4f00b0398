"""The live page, which shows a race in browsers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from stkzoo._checks import check_whole
from stkzoo._imports import import_extra
from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import RaceResult
from stkzoo.race.web import messages
from stkzoo.race.web.control import RaceControl
from stkzoo.render.scene import Scene


class RaceBroadcast:
    """A page that shows a race from its snapshots.

    The page is available as soon as the object exists. Call :meth:`begin`, :meth:`add` and
    :meth:`finish` to show a race, and :meth:`close` to close the page. Only :meth:`wait_turn`
    blocks.

    Args:
        host: address to serve on. If other machines can reach it (``"0.0.0.0"``), anyone may watch,
            but only viewers with the key in :attr:`url` may control the race.
        port: port to serve on; 0 selects a free port.
        speed: speed as a multiple of real time: 1, 2 or 4; ``None`` for no limit.
        paused: whether to wait on the grid until a viewer starts the race.

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
    ) -> None:
        check_whole("port", port, 0, 65535)
        import_extra("aiohttp", "the live page needs", "races")
        from stkzoo.race.web.server import LiveServer

        self.control = RaceControl(speed, paused=paused)
        self._server = LiveServer(host, port, self.control)
        self.port, self.url = self._server.port, self._server.url
        self._scene: Scene | None = None

    def begin(
        self,
        scene: Scene,
        snapshot: Snapshot,
        *,
        sources: Mapping[str, str] | None = None,
        seed: int | None = None,
        details: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Begins a race.

        Args:
            scene: description of the race.
            snapshot: state of the karts on the grid.
            sources: sources of the agents, by id.
            seed: the race's seed.
            details: see :meth:`add`.
        """
        self._scene = scene
        agents = tuple(f"kart_{number}" for number in range(len(scene.kart_indices)))
        race = messages.text_of(lambda: messages.race_message(scene, sources or {}, seed))
        self._server.news = messages.RaceNews(race, agents)
        self.control.begin()
        self.add(snapshot, 0, details=details)

    def add(
        self,
        snapshot: Snapshot,
        steps: int,
        *,
        rewards: Mapping[str, float] | None = None,
        details: Mapping[str, Mapping[str, Any]] | None = None,
        failures: Mapping[str, str] | None = None,
    ) -> None:
        """Shows the next step of the race.

        Args:
            snapshot: state after the step.
            steps: number of environment steps so far.
            rewards: sums of rewards since the start by agent.
            details: values for the page's tree by agent and part.
            failures: last failure by agent.

        Raises:
            ConfigError: called before :meth:`begin`.
        """
        scene = self._scene
        if scene is None:
            raise ConfigError("add() was called before begin(); call begin() first")
        totals = [0.0] * scene.num_kart
        for number, kart in enumerate(scene.kart_indices):
            totals[kart] = (rewards or {}).get(f"kart_{number}", 0.0)
        controls = snapshot.karts["control"]
        traces = messages.trace_row(scene, snapshot, controls, totals)
        news = self._server.news
        news.traces.add(steps, traces)

        def make_message() -> dict[str, Any]:
            message = messages.moment_message(scene, snapshot, steps, traces, controls)
            return {**message, "failures": dict(failures or {})}

        moment = messages.text_of(make_message)
        self._server.news = replace(news, moment=moment, steps=steps, details=details or {})

    def wait_turn(self) -> bool:
        """Waits until the next step is due at the speed and state that viewers have set.

        Returns:
            Whether the race continues; ``False`` if a viewer stopped it.
        """
        step_size = self._scene.setup.step_size if self._scene else 0.0
        return self.control.wait_turn(step_size)

    def finish(self, result: Mapping[str, Any]) -> None:
        """Ends the race and shows its result.

        Args:
            result: result in the format of :meth:`stkzoo.race.RaceResult.to_dict`.
        """
        self.control.finish()
        message = messages.text_of(lambda: {"type": "result", "result": result})
        self._server.news = replace(self._server.news, result=message)

    def close(self) -> None:
        """Closes the page; may be called more than once.

        Open browser windows keep the content that they have received.
        """
        self._server.close()


class LivePage(RaceBroadcast, RaceListener):
    """Listener that shows its race on a page, from which viewers can control it.

    The page is available from the creation of the object until the end of the race. The race also
    runs without viewers, and a slow viewer does not delay it.

    Args:
        stay: keep the page after the race until a viewer stops it or Ctrl-C is pressed.
        options: ``host``, ``port``, ``speed`` and ``paused``; see :class:`RaceBroadcast`.

    Raises:
        ConfigError: an argument is invalid, the port is taken, or aiohttp is not installed.
    """

    def __init__(self, *, stay: bool = False, **options: Any) -> None:
        super().__init__(**options)
        self._stay = stay

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        details = _details(race)
        self.begin(race.scene, race.snapshot, sources=race.sources, seed=race.seed, details=details)
        self._wait(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.add(
            race.snapshot,
            race.steps,
            rewards=race.total_rewards,
            details=_details(race),
            failures={agent: all_[-1].message for agent, all_ in race.failures.items() if all_},
        )
        self._wait(race)

    def ended(self, result: RaceResult) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.finish(result.to_dict())
        if self._stay and result.status != "interrupted":
            try:
                self.control.wait_stop()
            except KeyboardInterrupt:
                return  # the result is already complete

    def closed(self) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.close()

    def _wait(self, race: RaceProgress) -> None:
        if not self.wait_turn():
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
