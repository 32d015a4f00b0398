"""The live page: shows a race in browsers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from stkzoo.engine.snapshot import Snapshot
from stkzoo.errors import ConfigError
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import RaceResult
from stkzoo.race.web.control import RaceControl
from stkzoo.race.web.feed import RaceFeed
from stkzoo.race.web.messages import control_rows, moment_form, race_form, trace_row
from stkzoo.render.scene import Scene

if TYPE_CHECKING:
    from stkzoo.race.web.server import LiveServer

__all__ = ["LivePage", "RaceBroadcast"]


class RaceBroadcast:
    """A page that shows a race from its snapshots; knows nothing of who drives.

    It serves from the moment it is made; :meth:`begin`, :meth:`add` and :meth:`finish`
    tell it of a race, :meth:`close` ends it. Only :meth:`wait_turn` ever waits.

    Args:
        host: address to serve on. Beyond this machine (``"0.0.0.0"``) all may watch; only
            who opens :attr:`url` with its key may steer.
        port: port to serve on; 0 takes a free one.
        speed: times real time: 1, 2 or 4, or ``None`` for as fast as it goes.
        paused: wait on the grid until a viewer lets the race run.

    Raises:
        ConfigError: an argument cannot be, the port is taken, or aiohttp is missing.
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 8000,
        speed: float | None = 1.0,
        paused: bool = False,
    ) -> None:
        if not isinstance(port, int) or isinstance(port, bool) or not 0 <= port <= 65535:
            raise ConfigError(f"port is {port!r}, expected a whole number from 0 to 65535")
        self.control = RaceControl(speed, paused=paused)
        self._board = RaceFeed()
        self._server = _server(host, port, self._board, self.control)
        self._scene: Scene | None = None
        self.control.on_change = self._tell_state
        self._tell_state()

    @property
    def port(self) -> int:
        """Port that the page is served on."""
        return self._server.port

    @property
    def url(self) -> str:
        """Where the page is; with the key to steer, if one is needed."""
        address = self._server.address
        host = f"[{address}]" if ":" in address else address
        key = f"#key={self._server.key}" if self._server.key else ""
        return f"http://{host}:{self.port}/{key}"

    @property
    def num_viewers(self) -> int:
        """How many watch now."""
        return self._server.num_viewers

    def begin(
        self,
        scene: Scene,
        snapshot: Snapshot,
        *,
        sources: Mapping[str, str] | None = None,
        seed: int | None = None,
        sights: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """A race begins.

        Args:
            scene: the race.
            snapshot: the karts on the grid.
            sources: where agents come from, by id.
            seed: what the race was started with.
            sights: see :meth:`add`.
        """
        self._scene = scene
        self._board.set_race(race_form(scene, sources or {}, seed))
        self.control.begin()
        self.add(snapshot, 0, sights=sights)

    def add(
        self,
        snapshot: Snapshot,
        steps: int,
        *,
        actions: Mapping[str, Any] | None = None,
        rewards: Mapping[str, float] | None = None,
        sights: Mapping[str, Mapping[str, Any]] | None = None,
        failures: Mapping[str, str] | None = None,
    ) -> None:
        """The race has moved.

        Args:
            snapshot: its moment.
            steps: environment steps so far.
            actions: what agents did, in the game's own form.
            rewards: sums since the start, by agent.
            sights: for each agent what the page's tree can show: parts by name.
            failures: what went wrong last, by agent.

        Raises:
            ConfigError: before :meth:`begin`.
        """
        scene = self._scene
        if scene is None:
            raise ConfigError("add() before begin(); begin with the race's first moment")
        totals = [0.0] * scene.num_kart
        for number, kart in enumerate(scene.kart_indices):
            totals[kart] = (rewards or {}).get(f"kart_{number}", 0.0)
        controls = control_rows(scene, snapshot, actions or {})
        traces = trace_row(scene, snapshot, controls, totals)
        self._board.traces.add(steps, traces)

        def make_form() -> dict[str, Any]:
            form = moment_form(scene, snapshot, steps, traces, controls)
            return {**form, "failures": dict(failures or {})}

        self._board.set_moment(steps, make_form, sights or {})
        self._server.wake()

    def wait_turn(self) -> bool:
        """Waits until the race may go on, as viewers have it.

        Returns:
            Whether it may; ``False`` if it is to be stopped.
        """
        step_size = self._scene.setup.step_size if self._scene else 0.0
        return self.control.wait_turn(step_size)

    def finish(self, result: Mapping[str, Any]) -> None:
        """The race is over.

        Args:
            result: as :meth:`stkzoo.race.RaceResult.to_json` has it.
        """
        self.control.finish()
        self._board.set_result({"type": "result", "result": result})
        self._server.wake()

    def close(self) -> None:
        """Ends the page; viewers keep what they have. May be called again."""
        self._server.close()

    def _tell_state(self) -> None:
        self._board.set_state(lambda: {"type": "state", **self.control.form})
        self._server.wake()


def _server(host: str, port: int, board: RaceFeed, control: RaceControl) -> LiveServer:
    try:
        from stkzoo.race.web.server import LiveServer
    except ImportError as error:
        raise ConfigError(
            "the live page needs aiohttp, which is not installed: pip install 'stkzoo[web]'"
        ) from error
    return LiveServer(host, port, board, control)


class LivePage(RaceListener):
    """Shows the race it listens to on a page, from which it can be steered.

    The page is there from the moment this is made until the race is over. The race runs
    on without viewers, and never waits for one.

    Args:
        host: address to serve on; see :class:`~stkzoo.race.web.RaceBroadcast`.
        port: port to serve on; 0 takes a free one.
        speed: times real time: 1, 2 or 4, or ``None`` for as fast as it goes.
        paused: wait on the grid until a viewer lets the race run.
        stay: keep the page after the race until a viewer closes it, or Ctrl-C.

    Raises:
        ConfigError: an argument cannot be, the port is taken, or aiohttp is missing.
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
        self.broadcast = RaceBroadcast(host=host, port=port, speed=speed, paused=paused)
        self._stay = stay

    @property
    def url(self) -> str:
        """Where the page is."""
        return self.broadcast.url

    @property
    def port(self) -> int:
        """Port that the page is served on."""
        return self.broadcast.port

    @property
    def num_viewers(self) -> int:
        """How many watch now."""
        return self.broadcast.num_viewers

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        snapshot = race.env.snapshot
        assert snapshot is not None  # noqa: S101 - a race has started
        scene = _named_scene(race)
        sights = _sights(race)
        self.broadcast.begin(scene, snapshot, sources=race.sources, seed=race.seed, sights=sights)
        self._wait(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        snapshot = race.env.snapshot
        assert snapshot is not None  # noqa: S101 - a race runs
        self.broadcast.add(
            snapshot,
            race.steps,
            actions=race.actions,
            rewards=race.total_rewards,
            sights=_sights(race),
            failures={agent: all_[-1].message for agent, all_ in race.failures.items() if all_},
        )
        self._wait(race)

    def ended(self, result: RaceResult) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.broadcast.finish(json.loads(result.to_json()))
        if self._stay and result.status != "interrupted":
            try:
                self.broadcast.control.wait_stop()
            except KeyboardInterrupt:
                return  # who has seen enough has the result all the same

    def closed(self) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.broadcast.close()

    def _wait(self, race: RaceProgress) -> None:
        if not self.broadcast.wait_turn():
            race.stop("stopped")


def _named_scene(race: RaceProgress) -> Scene:
    """The race's scene, with the names that drivers give themselves."""
    scene = race.env.scene
    assert scene is not None  # noqa: S101 - a race has started
    names = list(scene.names)
    for agent, kart in zip(race.env.possible_agents, scene.kart_indices, strict=True):
        names[kart] = race.names[agent]
    return replace(scene, names=tuple(names))


def _sights(race: RaceProgress) -> dict[str, dict[str, object]]:
    """What the page's tree can show of every agent."""
    sights = {}
    for agent, info in race.infos.items():
        sights[agent] = {
            "observation": race.observations.get(agent, {}),
            "action": race.actions.get(agent, {}),
            "info": info,
        }
        if agent in race.seconds:
            sights[agent]["thinking"] = {"milliseconds": 1000 * race.seconds[agent]}
    return sights
