"""The listener that shows a race in browsers."""

from __future__ import annotations

import json
from dataclasses import replace

from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import RaceResult
from stkzoo.race.web.broadcast import RaceBroadcast
from stkzoo.render.scene import Scene

__all__ = ["LivePage"]


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
