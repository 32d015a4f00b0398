"""Races of drivers on the view ``racing`` against one another, several side by side.

Each drives one kart; the game's AI drives another one behind them.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from stkzoo import RaceParallelEnv, race_v0
from stkzoo.agents.pretrained.mlp import KartPolicy
from stkzoo.evaluation import load_ai_times

__all__ = [
    "COUNTDOWN",
    "PATIENCE",
    "STEP",
    "WORST",
    "Heat",
    "HeatEnd",
    "ai_time",
    "bots_of",
    "drive",
    "finishing_order",
]

#: How long a step is, and how long karts wait on the grid for GO [s].
STEP, COUNTDOWN = 0.1, 2.0
#: A race is cut short after so many times the AI's median time.
PATIENCE = 2.0
#: No time ratio is counted as worse.
WORST = 10.0


@functools.cache
def ai_time(track: str, reverse: bool, difficulty: int) -> float:
    """The median time of the game's AI [s]; the difficulty makes all karts quicker."""
    return load_ai_times().of(track, reverse, difficulty).median


def bots_of(difficulty: int) -> str:
    """What the bots of a difficulty are called as rivals."""
    return f"bot:{difficulty}"


@dataclass(frozen=True, slots=True)
class Heat:
    """A race to be driven.

    Attributes:
        names: who drives, from the front of the grid on; some may be there twice.
        track: its name.
        seed: of the race.
        reverse: the other way round.
        difficulty: of the game's AI.
    """

    names: tuple[str, ...]
    track: str
    seed: int
    reverse: bool = False
    difficulty: int = 3


@dataclass(frozen=True, slots=True)
class HeatEnd:
    """How it went.

    Attributes:
        order: who came in first, second, ..., the game's AI as ``bot:3`` or such; each once, at its
            better place.
        ratios: of each driver: its better time over the median time of the game's AI in such a
            race; who did not finish counts as if going on at its pace, :data:`WORST` at most.
    """

    order: list[str]
    ratios: dict[str, float]


class _Run:
    """A heat that is being driven."""

    def __init__(self, heat: Heat, drivers: Mapping[str, Callable[[], KartPolicy]]) -> None:
        self.heat = heat
        self.ai_time = ai_time(heat.track, heat.reverse, heat.difficulty)
        self.env: RaceParallelEnv = race_v0.parallel_env(
            agents=len(heat.names),
            num_kart=len(heat.names) + 1,
            track=heat.track,
            reverse=heat.reverse,
            difficulty=heat.difficulty,
            view="racing",
            max_cycles=math.ceil((PATIENCE * self.ai_time + COUNTDOWN) / STEP),
        )
        self.seen: dict[str, Any] = {}
        self.last: dict[str, Any] = {}
        self._names = dict(zip(self.env.possible_agents, heat.names, strict=True))
        self._seats = {agent: drivers[name]() for agent, name in self._names.items()}

    def begin(self) -> None:
        self.seen, _ = self.env.reset(seed=self.heat.seed)

    def ask(self) -> None:
        self.env.step_async(
            {agent: self._seats[agent](seen[None])[0] for agent, seen in self.seen.items()}
        )

    def take_in(self) -> None:
        seen, _, _, _, infos = self.env.step_wait()
        self.last.update(infos)
        self.seen = {agent: seen[agent] for agent in self.env.agents}

    def end(self) -> HeatEnd:
        assert self.env.track_map is not None  # noqa: S101 - since begin
        speed = self.env.track_map.length / self.ai_time
        places = {int(info["position"]): self._names[agent] for agent, info in self.last.items()}
        ratios: dict[str, float] = {}
        for agent, info in self.last.items():
            name = self._names[agent]
            ratios[name] = min(_ratio(info, speed), ratios.get(name, WORST))
        return HeatEnd(finishing_order(places, bots_of(self.heat.difficulty)), ratios)


def finishing_order(places: Mapping[int, str], ai: str) -> list[str]:
    """Who came in first, second, ...; each once, at the better place.

    Args:
        places: who came in at which place; one from 1 on is missing.
        ai: who came in there.
    """
    (of_ai,) = set(range(1, len(places) + 2)) - set(places)
    found = {**places, of_ai: ai}
    return list(dict.fromkeys(found[place] for place in sorted(found)))


def _ratio(info: Mapping[str, Any], ai_speed: float) -> float:
    seconds = STEP * int(info["episode/length"]) - COUNTDOWN
    pace = float(info["distance"]) / max(seconds, STEP) / ai_speed
    return 1.0 / max(pace, 1.0 / WORST)


def drive(heats: Sequence[Heat], drivers: Mapping[str, Callable[[], KartPolicy]]) -> list[HeatEnd]:
    """Drives some races side by side.

    Args:
        heats: the races.
        drivers: of all that drive in them: what makes a seat for one kart in one race.
    """
    with contextlib.ExitStack() as stack:
        runs = []
        for heat in heats:
            runs.append(_Run(heat, drivers))
            stack.enter_context(contextlib.closing(runs[-1].env))
            runs[-1].begin()
        while under_way := [run for run in runs if run.env.agents]:
            for run in under_way:
                run.ask()
            for run in under_way:
                run.take_in()
        return [run.end() for run in runs]
