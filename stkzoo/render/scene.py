"""What a picture needs to know of a race beside its moments."""

from __future__ import annotations

from dataclasses import dataclass, field

from stkzoo.engine.setup import RaceSetup
from stkzoo.engine.track import TrackMap
from stkzoo.render.palette import race_palette

__all__ = ["Scene"]


@dataclass(frozen=True)
class Scene:
    """A race as its pictures show it.

    Attributes:
        setup: what the engine was told.
        track_map: the track.
        kart_types: model name of each kart, in grid order.
        kart_indices: each agent's kart; the other karts are the game's own.
        names: what to call each kart, in grid order; made up if left out.
        colours: of each kart, in grid order: agents first in :func:`race_palette`.
    """

    setup: RaceSetup
    track_map: TrackMap
    kart_types: tuple[str, ...]
    kart_indices: tuple[int, ...]
    names: tuple[str, ...] = ()
    colours: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        agents = {kart: number for number, kart in enumerate(self.kart_indices)}
        bots = [kart for kart in range(self.num_kart) if kart not in agents]
        order = {**agents, **{kart: len(agents) + row for row, kart in enumerate(bots)}}
        palette = race_palette(self.num_kart)
        karts = range(self.num_kart)
        object.__setattr__(self, "colours", tuple(palette[order[kart]] for kart in karts))
        if not self.names:
            names = [_name(self, kart, agents.get(kart)) for kart in karts]
            object.__setattr__(self, "names", tuple(names))

    @property
    def num_kart(self) -> int:
        """Number of karts."""
        return len(self.setup.karts)

    @property
    def title(self) -> str:
        """The track's name for people."""
        name = self.setup.track.replace("_", " ")
        return f"{name} (reverse)" if self.setup.reverse else name

    def label(self, kart: int) -> str:
        """The short sign of a kart on the map: its agent's number, or a dot."""
        return str(self.kart_indices.index(kart)) if kart in self.kart_indices else ""


def _name(scene: Scene, kart: int, agent: int | None) -> str:
    given = scene.setup.karts[kart].name
    if agent is None:
        return given or "the game"
    return given or f"kart_{agent}"
