"""Map films of races: the location of each kart, twice per second, or less often in long races."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt
from msgspec import Meta

from stkzoo._schema import Positive
from stkzoo.errors import ConfigError
from stkzoo.evaluation.templates import render
from stkzoo.race.document import Document
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.render.palette import race_palette

_INTERVAL = 0.5  # [s]
_MAX_MOMENTS = 600
_SIZE = 800  # longer side of the image [pixels]
_SPEED = 4.0  # game time per time of the film

#: A coordinate [m].
_Meters = Annotated[float, Meta(ge=-1e6, le=1e6)]


@dataclass(frozen=True, slots=True)
class MapFilm(Document):
    """The locations of karts during a race, as x and z in the world frame [m].

    Attributes:
        track: name of the track.
        interval: game time between two moments [s].
        width: median width of the road [m].
        road: start and end of each segment of the center line: x, z, x, z.
        karts: by label of the agent, x and z of its kart at each moment, in one sequence.
    """

    type_name: ClassVar[str] = "map-film"
    origin: ClassVar[str] = "the folder films of a tournament"

    track: str
    interval: Positive
    width: Annotated[float, Meta(gt=0, le=1e6)]
    road: Annotated[tuple[tuple[_Meters, _Meters, _Meters, _Meters], ...], Meta(min_length=1)]
    karts: Annotated[Mapping[str, tuple[_Meters, ...]], Meta(min_length=1, max_length=256)]

    def __post_init__(self) -> None:
        if len({len(way) for way in self.karts.values()}) > 1 or any(
            len(way) % 2 for way in self.karts.values()
        ):
            raise ConfigError(
                "the karts of the film have different numbers of positions, or half a position"
            )

    def to_json(self) -> str:
        """Returns the film as one line of JSON."""
        values = {"type": self.type_name, "schema_version": self.version, **self.to_dict()}
        return json.dumps(values, separators=(",", ":"), allow_nan=False)


class FilmRecorder(RaceListener):
    """A race listener that records a film in bounded memory.

    When a film is full, it drops every second moment and halves the rate of further ones.
    """

    def __init__(self) -> None:
        self._places: list[list[list[float]]] = []

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._step = float(race.env.options.step_size)
        self._every = max(1, round(_INTERVAL / self._step))
        self._map, self._track = race.scene.track_map, race.race_info.track
        self._labels = [race.names[agent] for agent in race.env.possible_agents]
        self._add(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        if race.steps % self._every == 0:
            self._add(race)
        if len(self._places) > _MAX_MOMENTS:
            self._places, self._every = self._places[::2], 2 * self._every

    def film(self) -> MapFilm:
        """Returns the film recorded so far. Call it after the race has started."""
        road = _rounded(self._map.path_nodes[..., ::2].reshape(-1, 4))
        ways = np.array(self._places).transpose(1, 0, 2).reshape(len(self._labels), -1)
        return MapFilm(
            track=self._track,
            interval=self._every * self._step,
            width=float(np.median(self._map.path_width)),
            road=tuple((a, b, c, d) for a, b, c, d in road),
            karts=dict(zip(self._labels, map(tuple, ways.tolist()), strict=True)),
        )

    def _add(self, race: RaceProgress) -> None:
        karts = list(race.race_info.kart_indices)
        self._places.append(_rounded(race.snapshot.karts["location"][karts, ::2]))


def _rounded(places: npt.NDArray[np.float32]) -> list[list[float]]:
    rows: list[list[float]] = places.astype(np.float64).round(1).tolist()
    return rows


def draw_film(film: MapFilm, name: str, *, is_looped: bool = False) -> tuple[str, dict[str, str]]:
    """Draws a film as an SVG image that plays on a click.

    Args:
        film: the film.
        name: id of the SVG element in its page.
        is_looped: whether the film is a separate file that plays automatically in a loop.

    Returns:
        The SVG, and the color of each agent by label.
    """
    road = np.array(film.road).reshape(-1, 2, 2)
    low, high = road.min((0, 1)) - film.width, road.max((0, 1)) + film.width
    scale = _SIZE / float((high - low).max())

    def pixels(places: Any) -> npt.NDArray[np.int64]:
        """Converts locations to pixels, with z pointing up."""
        moved = (np.array(places).reshape(-1, 2) - low) * scale
        return np.rint([moved[:, 0], (high - low)[1] * scale - moved[:, 1]]).astype(np.int64)

    colors = dict(zip(film.karts, race_palette(len(film.karts)), strict=True))
    ways = [(colors[label], pixels(way).tolist()) for label, way in film.karts.items()]
    moments = len(ways[0][1][0])
    width, height = ((high - low) * scale).astype(int).tolist()
    picture = render(
        Path(__file__).with_name("film.svg.jinja"),
        name=name,
        is_looped=is_looped,
        width=width,
        height=height,
        size=_SIZE,
        road=pixels(road).T.reshape(-1, 4).tolist(),
        road_width=max(film.width * scale, 8),
        karts=ways[::-1],
        seconds=max((moments - 1) * film.interval / _SPEED, 0.1),
    )
    return picture, colors


def film_file(folder: Path, number: int) -> Path:
    """Returns the file of a race's film in the tournament's folder."""
    return folder / "films" / f"{number:05d}.json"
