"""Listeners of a race, and the race state that they receive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stkzoo.race.result import AgentFailure, RaceResult

if TYPE_CHECKING:
    from stkzoo.engine.snapshot import Snapshot
    from stkzoo.env.grid import RaceInfo
    from stkzoo.env.parallel import RaceParallelEnv
    from stkzoo.render.scene import Scene


@dataclass(frozen=True, slots=True)
class RaceProgress:
    """Read-only state of a race after a step.

    Attributes:
        env: the race's environment.
        names: display name of each agent.
        sources: source of each agent.
        seed: seed of the environment's reset.
        steps: number of environment steps so far.
        race_time: game time of these steps [s], countdown included.
        race_length: number of laps times the lap length [m].
        distances: distance driven by each agent [m], at most ``race_length``.
        observations: current observations by agent, in the ``full`` view; without agents that
            finished before the last step.
        actions: actions of the last step by agent, in the game's action space; without agents that
            the game's AI drives.
        rewards: rewards of the last step by agent.
        total_rewards: sums of rewards since the start by agent.
        infos: last info of each agent.
        failures: failures so far by agent.
        seconds: duration of each driver's last decision [s].
        stop: ends the race after this step. Its argument is the reason, which becomes the result's
            ``status``.
    """

    env: RaceParallelEnv
    names: Mapping[str, str]
    sources: Mapping[str, str]
    seed: int
    steps: int
    race_time: float
    race_length: float
    distances: Mapping[str, float]
    observations: Mapping[str, Any]
    actions: Mapping[str, Any]
    rewards: Mapping[str, float]
    total_rewards: Mapping[str, float]
    infos: Mapping[str, Mapping[str, Any]]
    failures: Mapping[str, tuple[AgentFailure, ...]]
    seconds: Mapping[str, float]
    stop: Callable[[str], None]

    @property
    def leader_distance(self) -> float:
        """Distance driven by the leading agent [m]."""
        return max(self.distances.values())

    @property
    def snapshot(self) -> Snapshot:
        """Current state of all karts and items."""
        return self.env.live_race.running("snapshot").snapshot

    @property
    def scene(self) -> Scene:
        """Description of the race for renderers."""
        scene = self.env.scene
        assert scene is not None  # noqa: S101 - the race has started
        return scene

    @property
    def race_info(self) -> RaceInfo:
        """Facts about the race, such as its track and karts."""
        return self.env.live_race.running("race_info").race


class RaceListener:
    """Observes a race. Subclasses override the methods that they need.

    The race waits until each call of a listener returns. An exception in a listener ends the race.
    """

    def env_options(self) -> dict[str, Any]:
        """Returns arguments that the race's environment needs, such as ``render_mode``."""
        return {}

    def started(self, race: RaceProgress) -> None:
        """Called when the karts are on the grid."""

    def stepped(self, race: RaceProgress) -> None:
        """Called after each step."""

    def ended(self, result: RaceResult) -> None:
        """Called when the race has ended, also after an interrupt, but not after an error.

        The environment is still open.
        """

    def closed(self) -> None:
        """Called last, also after an error. Release resources here."""


class ExpendableListener(RaceListener):
    """Forwards all calls to another listener, whose failure does not end the race.

    After a failure, the other listener is closed and receives no further calls.

    Args:
        listener: the other listener.

    Attributes:
        error: the listener's failure; ``None`` without one.
    """

    def __init__(self, listener: RaceListener) -> None:
        self._listener = listener
        self.error: Exception | None = None

    def env_options(self) -> dict[str, Any]:
        """See :class:`RaceListener`."""
        return self._listener.env_options()

    def started(self, race: RaceProgress) -> None:
        """See :class:`RaceListener`."""
        self._forward(self._listener.started, race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`RaceListener`."""
        self._forward(self._listener.stepped, race)

    def ended(self, result: RaceResult) -> None:
        """See :class:`RaceListener`."""
        self._forward(self._listener.ended, result)

    def closed(self) -> None:
        """See :class:`RaceListener`."""
        self._forward(self._listener.closed)

    def _forward(self, call: Callable[..., None], *arguments: Any) -> None:
        if self.error is not None:
            return
        try:
            call(*arguments)
        except Exception as error:  # noqa: BLE001 - a listener may raise anything
            self.error = error
            with suppress(Exception):
                self._listener.closed()
