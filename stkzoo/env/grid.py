"""Who starts where, and what the engine is told about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.config import AgentSpec
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.env.options import RaceOptions, camera_mode

__all__ = ["RaceInfo", "draw_race"]


@dataclass(frozen=True, slots=True)
class RaceInfo:
    """What a race is called and who drives where.

    Attributes:
        track: the track's name.
        reverse: whether it is driven the other way round.
        laps: number of laps.
        difficulty: the bots' level.
        seed: the engine's own seed.
        kart_indices: each agent's kart, as an index in grid order.
        kart_types: model name of each kart, in grid order; empty until the race stands.
    """

    track: str
    reverse: bool
    laps: int
    difficulty: int
    seed: int
    kart_indices: tuple[int, ...]
    kart_types: tuple[str, ...] = ()


def draw_race(
    options: RaceOptions,
    agents: Sequence[AgentSpec],
    tracks: Sequence[str],
    num_cameras: int,
    random: np.random.Generator,
) -> tuple[RaceSetup, RaceInfo]:
    """Draws what is left to chance: the track, the engine's seed and the free grid places."""
    track = tracks[int(random.integers(len(tracks)))]
    seed = int(random.integers(2**16))
    kart_indices = _draw_places(agents, options.num_kart, random)
    karts = [KartSetup()] * options.num_kart
    for agent, index in zip(agents, kart_indices, strict=True):
        karts[index] = KartSetup(
            is_bot=agent.use_ai,
            reports_control=agent.use_ai,
            kart=agent.kart,
            name=agent.name,
            color=float(agent.color),
            camera_mode=int(camera_mode(agent)),
        )
    setup = RaceSetup(
        track=track,
        karts=tuple(karts),
        laps=int(options.laps),
        reverse=options.reverse,
        difficulty=int(options.difficulty),
        seed=seed,
        step_size=float(options.step_size),
        num_cameras=num_cameras,
    )
    info = RaceInfo(
        track=track,
        reverse=setup.reverse,
        laps=setup.laps,
        difficulty=setup.difficulty,
        seed=seed,
        kart_indices=kart_indices,
    )
    return setup, info


def _draw_places(
    agents: Sequence[AgentSpec], num_kart: int, random: np.random.Generator
) -> tuple[int, ...]:
    taken = {agent.rank_start for agent in agents}
    free = [place for place in range(num_kart) if place not in taken]
    drawn = iter(random.permutation(free).tolist())
    return tuple(
        int(next(drawn) if agent.rank_start is None else agent.rank_start) for agent in agents
    )
