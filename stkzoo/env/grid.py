"""Who starts where, and what the engine is told about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.config import AgentSpec
from stkzoo.engine.setup import KartSetup, RaceSetup
from stkzoo.env.options import MAX_CAMERAS, RaceOptions, camera_mode
from stkzoo.env.starts import draw_starts
from stkzoo.names import CameraMode


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
        kart_types: model name of each kart, in grid order.
        opponent_indices: each opponent's kart, as an index in grid order.
        opponents: each opponent's name.
    """

    track: str
    reverse: bool
    laps: int
    difficulty: int
    seed: int
    kart_indices: tuple[int, ...]
    kart_types: tuple[str, ...]
    opponent_indices: tuple[int, ...] = ()
    opponents: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RaceRoster:
    """Who races, as far as a saved race and an environment have to agree.

    Attributes:
        num_kart: number of karts.
        num_agents: number of agents.
        ai_agents: the agents that the game's AI drives.
    """

    num_kart: int
    num_agents: int
    ai_agents: frozenset[str]

    def __str__(self) -> str:
        of_ai = f" ({', '.join(sorted(self.ai_agents))} with use_ai)" if self.ai_agents else ""
        return f"{self.num_kart} karts and {self.num_agents} agents{of_ai}"


def draw_race(
    options: RaceOptions,
    agents: Sequence[AgentSpec],
    tracks: Sequence[str],
    num_cameras: int,
    has_window: bool,
    random: np.random.Generator,
    opponents: Sequence[AgentSpec] = (),
) -> tuple[RaceSetup, tuple[int, ...]]:
    """Draws what is left to chance: the track, the engine's seed and the free grid places.

    In a window for which neither ``num_cameras`` nor an agent asks for a camera, those
    agents get one that the game's AI does not drive; if there are none, the first agent.

    Returns:
        The engine's options, and the karts of the agents and then of the opponents as indices
        in grid order.
    """
    track = tracks[int(random.integers(len(tracks)))]
    seed = int(random.integers(2**16))
    everyone = [*agents, *opponents]
    kart_indices = _draw_places(everyone, options.num_kart, random)
    karts = [KartSetup()] * options.num_kart
    cameras = [camera_mode(agent) for agent in agents]
    if has_window and not num_cameras and CameraMode.ON not in cameras:
        cameras = _with_cameras(agents, cameras)
    cameras += [camera_mode(opponent) for opponent in opponents]
    for number, (agent, index) in enumerate(zip(everyone, kart_indices, strict=True)):
        karts[index] = KartSetup(
            is_bot=agent.use_ai,
            reports_control=agent.use_ai and number < len(agents),
            kart=agent.kart,
            name=agent.name,
            color=float(agent.color),
            camera_mode=int(cameras[number]),
        )
    names = [f"kart_{number}" for number in range(len(everyone))]
    setup = RaceSetup(
        track=track,
        karts=tuple(karts),
        laps=int(options.laps),
        reverse=options.reverse,
        difficulty=int(options.difficulty),
        seed=seed,
        step_size=float(options.step_size),
        num_cameras=num_cameras,
        starts=draw_starts(options.start, names, kart_indices, options.num_kart, random),
    )
    return setup, kart_indices


def _with_cameras(agents: Sequence[AgentSpec], modes: Sequence[CameraMode]) -> list[CameraMode]:
    seen = [row for row, agent in enumerate(agents) if not agent.use_ai][:MAX_CAMERAS] or [0]
    return [
        CameraMode.ON if mode is CameraMode.AUTO and row in seen else mode
        for row, mode in enumerate(modes)
    ]


def _draw_places(
    agents: Sequence[AgentSpec], num_kart: int, random: np.random.Generator
) -> tuple[int, ...]:
    taken = {agent.rank_start for agent in agents}
    free = [place for place in range(num_kart) if place not in taken]
    drawn = iter(random.permutation(free).tolist())
    return tuple(
        int(next(drawn) if agent.rank_start is None else agent.rank_start) for agent in agents
    )
