"""How a race ended."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field

__all__ = ["AgentResult", "RaceResult"]


@dataclass(frozen=True, slots=True)
class AgentResult:
    """How one agent's race ended.

    Attributes:
        agent: its id in the environment.
        driver: who drove.
        rank: its place, 1 is first; those who did not finish follow by distance.
        finish_time: race time at the finish [s]; ``None`` if it did not finish.
        laps: laps done.
        distance: driven along the track since the start line [m].
        reward: the sum over the race.
    """

    agent: str
    driver: str
    rank: int
    finish_time: float | None
    laps: int
    distance: float
    reward: float


@dataclass(frozen=True, slots=True)
class RaceResult:
    """How a race ended.

    Attributes:
        track: its name.
        reverse: whether it was driven the other way round.
        laps: laps to drive.
        difficulty: level of the game's AI, 0 to 3.
        seed: what the environment was reset with; the same seed gives the same race.
        race_length: laps times the lap's length [m].
        steps: environment steps it took.
        agents: one entry an agent, best rank first.
        wall_time: how long it took here [s]; left out when results are compared.
    """

    track: str
    reverse: bool
    laps: int
    difficulty: int
    seed: int
    race_length: float
    steps: int
    agents: tuple[AgentResult, ...]
    wall_time: float = field(compare=False, default=0.0)

    @property
    def is_finished(self) -> bool:
        """Whether all agents have finished."""
        return all(agent.finish_time is not None for agent in self.agents)

    def to_json(self) -> str:
        """The result as JSON, with this class's names."""
        return json.dumps(asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str) -> RaceResult:
        """Reads what :meth:`to_json` wrote."""
        values = json.loads(text)
        agents = tuple(AgentResult(**agent) for agent in values.pop("agents"))
        return cls(**values, agents=agents)
