"""Listeners of a race, and what they get from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from stkzoo.race.result import AgentFailure, RaceResult

if TYPE_CHECKING:
    from stkzoo.engine.snapshot import Snapshot
    from stkzoo.env.grid import RaceInfo
    from stkzoo.env.parallel import RaceParallelEnv
    from stkzoo.render.scene import Scene

_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True)
class RaceProgress:
    """One moment of a race, read-only.

    Attributes:
        env: the race's environment.
        names: name to show of every agent.
        sources: source of every agent.
        seed: seed of the environment's reset.
        steps: environment steps so far.
        race_time: game time of these steps [s].
        race_length: laps times the lap's length [m].
        distances: distance driven by each agent, at most ``race_length`` [m].
        observations: observations of the agents now, in the ``full`` view; without agents that
            finished before the last step.
        actions: actions of the last step, by agent, in the game's own form; without the agents
            that the game drives.
        rewards: of the last step.
        total_rewards: since the start.
        infos: every agent's last info.
        failures: failures so far, by agent.
        seconds: duration of each driver's last decision [s].
        stop: ends the race after this step; takes the reason, for the result's ``status``.
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
        """Distance of the agent in front [m]."""
        return max(self.distances.values())

    @property
    def snapshot(self) -> Snapshot:
        """The state of all karts and items now."""
        return _present(self.env.snapshot)

    @property
    def scene(self) -> Scene:
        """The race as pictures need it."""
        return _present(self.env.scene)

    @property
    def race_info(self) -> RaceInfo:
        """Names of the race and its karts."""
        return _present(self.env.race)


def _present(value: _Value | None) -> _Value:
    assert value is not None  # noqa: S101 - the race has started
    return value


class RaceListener:
    """Watches a race. Subclasses define the methods that they need.

    The race waits for its listeners. An exception in one ends the race.
    """

    def env_options(self) -> dict[str, Any]:
        """Arguments of the race's environment that the listener needs, such as ``render_mode``."""
        return {}

    def started(self, race: RaceProgress) -> None:
        """Called when the karts stand on the grid."""

    def stepped(self, race: RaceProgress) -> None:
        """Called after every step."""

    def ended(self, result: RaceResult) -> None:
        """Called when the race is over, also by an interrupt, but not after an error.

        The environment is still open.
        """

    def closed(self) -> None:
        """Called last, also after an error; free resources here."""


class ResultKeeper(RaceListener):
    """Keeps the result, also if another listener fails after the race.

    Attributes:
        result: the race's result; ``None`` until it is over.
    """

    def __init__(self) -> None:
        self.result: RaceResult | None = None

    def ended(self, result: RaceResult) -> None:
        """Keeps the result."""
        self.result = result


class ExpendableListener(RaceListener):
    """A listener whose failure does not end the race; from then on the listener gets nothing.

    Args:
        listener: the listener.

    Attributes:
        error: its first failure; ``None`` without one.
    """

    def __init__(self, listener: RaceListener) -> None:
        self._listener = listener
        self.error: Exception | None = None

    def env_options(self) -> dict[str, Any]:
        """See :class:`RaceListener`."""
        return self._listener.env_options()

    def started(self, race: RaceProgress) -> None:
        """See :class:`RaceListener`."""
        self._call(self._listener.started, race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`RaceListener`."""
        self._call(self._listener.stepped, race)

    def ended(self, result: RaceResult) -> None:
        """See :class:`RaceListener`."""
        self._call(self._listener.ended, result)

    def closed(self) -> None:
        """See :class:`RaceListener`; called once, also by a failure."""
        if self.error is None:
            self._call(self._listener.closed)

    def _call(self, function: Callable[..., None], *arguments: object) -> None:
        if self.error is not None:
            return
        try:
            function(*arguments)
        except Exception as error:  # noqa: BLE001 - whatever fails in a listener
            self.error = error
            with suppress(Exception):
                self._listener.closed()
