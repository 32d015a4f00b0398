"""The starting grid: draws a race and builds its setup for the engine."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.config import AgentSpec
from stkzoo.engine.setup import MAX_CAMERAS, NO_TEAM, KartSetup, RaceSetup
from stkzoo.env.options import RaceOptions, camera_mode
from stkzoo.env.starts import draw_starts
from stkzoo.names import CameraMode


@dataclass(frozen=True, slots=True, kw_only=True)
class RaceInfo(RaceSetup):
    """A race that has started, and its karts.

    Attributes:
        kart_indices: index of each agent's kart in grid order.
        kart_types: model of each kart, in grid order.
        opponent_indices: index of each opponent's kart in grid order.
    """

    kart_indices: tuple[int, ...]
    kart_types: tuple[str, ...]
    opponent_indices: tuple[int, ...] = ()

    @property
    def opponents(self) -> tuple[str, ...]:
        """Name of each opponent."""
        return tuple(self.karts[kart].name for kart in self.opponent_indices)


def roster_of(
    num_kart: int, num_agents: int, ai_agents: Collection[str], has_opponents: bool
) -> str:
    """Describes the karts and agents of a race; a saved state and an environment must agree.

    Args:
        num_kart: number of karts.
        num_agents: number of agents.
        ai_agents: agents that the game's AI drives.
        has_opponents: whether there are opponents.
    """
    of_ai = f" ({', '.join(sorted(ai_agents))} with use_ai)" if ai_agents else ""
    opponents = " with opponents" if has_opponents else ""
    return f"{num_kart} karts and {num_agents} agents{of_ai}{opponents}"


def draw_race(
    options: RaceOptions,
    agents: Sequence[AgentSpec],
    tracks: Sequence[str],
    num_cameras: int,
    has_window: bool,
    random: np.random.Generator,
    opponents: Sequence[AgentSpec] = (),
) -> tuple[RaceSetup, tuple[int, ...]]:
    """Draws the random parts of a race: track, direction, the engine's seed, free grid positions.

    If the race has a window and neither ``num_cameras`` nor any agent requests a camera, all agents
    that the game's AI does not drive get one, or else the first agent.

    Args:
        options: options of the race.
        agents: options of the agents.
        tracks: tracks from which to draw.
        num_cameras: number of agents with a camera; 0 leaves the choice to the agents.
        has_window: whether the race is shown in a window.
        random: random generator.
        opponents: options of the opponents' karts.

    Returns:
        The setup for the engine, and the kart indices, in grid order, of the agents followed by
            those of the opponents.
    """
    track = tracks[int(random.integers(len(tracks)))]
    reverse = bool(random.integers(2)) if options.reverse is None else options.reverse
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
            kart=agent.kart or "",
            name=agent.name,
            color=float(agent.color),
            camera_mode=int(cameras[number]),
            team=NO_TEAM if agent.team is None else agent.team,
        )
    names = [f"kart_{number}" for number in range(len(everyone))]
    setup = RaceSetup(
        track=track,
        karts=tuple(karts),
        laps=int(options.laps),
        reverse=reverse,
        mode=options.mode,
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
