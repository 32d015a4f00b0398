"""What a race tells those who watch it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from stkzoo.race.result import AgentFailure, RaceResult

if TYPE_CHECKING:
    from stkzoo.env.parallel import RaceParallelEnv

__all__ = ["RaceListener", "RaceProgress"]


@dataclass(frozen=True, slots=True)
class RaceProgress:
    """One moment of a race. What it holds is to be read, not changed.

    Attributes:
        env: the race's environment: ``env.snapshot``, ``env.race``, ``env.track_map``.
        names: every agent's name to show.
        sources: where every agent comes from.
        seed: what the environment was reset with.
        steps: environment steps so far.
        race_time: game time of these steps [s].
        race_length: laps times the lap's length [m].
        distances: metres driven by each agent, at most ``race_length``.
        observations: what the agents see now, in the ``full`` view; those who have
            finished are left out from the step after.
        actions: what was done in the last step, by agent, in the game's own form; without
            the agents that the game drives.
        rewards: of the last step.
        total_rewards: since the start.
        infos: every agent's last info.
        failures: what has gone wrong, by agent.
        seconds: how long each driver thought about the last step.
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
        """Metres driven by whoever has come farthest."""
        return max(self.distances.values())


class RaceListener:
    """Watches a race. Subclasses define the methods that they need.

    A listener may take its time: the race waits for it. What it raises ends the race.
    """

    def env_options(self) -> dict[str, Any]:
        """Arguments that the race's environment needs for it, such as ``render_mode``."""
        return {}

    def started(self, race: RaceProgress) -> None:
        """The karts stand on the grid."""

    def stepped(self, race: RaceProgress) -> None:
        """The race has moved by one step."""

    def ended(self, result: RaceResult) -> None:
        """The race is over, perhaps by an interrupt; not called when it ends by an error.

        The environment is still open.
        """

    def closed(self) -> None:
        """The last call in any case, also after an error; a place to free what was opened."""
