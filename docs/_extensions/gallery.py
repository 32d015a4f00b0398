"""Draws the pictures of the gallery: those of each track and of each view.

    python docs/_extensions/gallery.py              # all, ten minutes without a graphics card
    python docs/_extensions/gallery.py --only views

A track has a frame from the game's renderer and a film of one lap on the map. A view has a drawing
of its observation and, if the observation is a vector, a plot of its values. All views show the
same moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from stkzoo import GroundKind, Start, race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.errors import EngineError
from stkzoo.evaluation import GRAY, INK, new_figure, style_axes
from stkzoo.evaluation.tournament.film import FilmRecorder, draw_film
from stkzoo.race import RaceListener, RaceProgress, run_race
from stkzoo.race.video import without_names
from stkzoo.render.renderer import RaceRenderer
from stkzoo.tracks import SPLITS
from stkzoo.views import views
from stkzoo.wrappers.racing import PLACES
from stkzoo.wrappers.racing.features import MARKS

IMAGES = Path(__file__).parents[1] / "images"
_FRAME_SIZE, _FRAME_STEP = (480, 270), 45
_DRIVERS = ("heuristic", *(f"ai@:AI {number}" for number in range(1, 5)))

#: The moment that all views show: four karts before a curve on hacienda.
_TRACK, _SEED = "hacienda", 1
_STARTS = {
    "kart_0": Start(share=0.31, speed=12.0),
    "kart_1": Start(share=0.315, offset=2.0, speed=12.0),
    "kart_2": Start(share=0.32, offset=-2.0, speed=12.0),
    "kart_3": Start(share=0.30, speed=12.0),
}
_REACH = 60.0  # [m]
_ROAD, _KART, _ITEM = "#c9ced6", "#d1495b", "#e9a03b"
_GROUND_COLORS = {
    GroundKind.VOID: "#3c5ac8",
    GroundKind.GROUND: "#b9b9b9",
    GroundKind.SLOWED: "#e1c878",
    GroundKind.ZIPPER: "#00a03c",
    GroundKind.WALL: "#c81e1e",
}

Array = npt.NDArray[Any]
#: Road segments as start, end and line width; then karts and items, ``(N, 2)`` x and z [m].
Surroundings = tuple[list[tuple[Array, Array, float]], Array, Array]


# ---------------------------------------------------------------------- tracks


class FrameRecorder(RaceListener):
    """Keeps one frame of a race, rendered by the game.

    Args:
        size: width and height of the frame [pixels].
        step: step of the race to render.
        kart: kart with the camera, counted from 0.

    Attributes:
        frame: the image; ``None`` before its step, or if the game cannot render the track.
    """

    def __init__(
        self, size: tuple[int, int] = _FRAME_SIZE, step: int = _FRAME_STEP, kart: int = 0
    ) -> None:
        self.frame: Array | None = None
        self._step, self._kart = step, kart
        self._renderer = RaceRenderer("engine", size)

    def stepped(self, race: RaceProgress) -> None:
        """Renders the frame at its step."""
        if race.steps == self._step:
            scene = without_names(race.scene, range(len(race.scene.setup.karts)))
            self._renderer.begin(
                replace(scene, setup=replace(scene.setup, num_cameras=self._kart + 1))
            )
            with suppress(EngineError):  # pystk2 0.7.4 crashes on mines with Mesa 22.3
                self.frame = list(self._renderer.pictures(race.snapshot).values())[self._kart]
            self._renderer.close()


def draw_track(track: str) -> None:
    """Writes a track's frame and its lap film."""
    frame, film = FrameRecorder(), FilmRecorder()
    run_race(_DRIVERS, track=track, difficulty=3, seed=1, listeners=[frame, film])
    if frame.frame is not None:
        picture = Image.fromarray(frame.frame)
        picture.save(IMAGES / "tracks" / f"{track}-frame.webp", quality=70, method=6)
    svg, _ = draw_film(film.film(), track, is_looped=True)
    write_text(IMAGES / "tracks" / f"{track}-lap.svg", svg)


# ---------------------------------------------------------------------- views


def draw_view(name: str) -> None:
    """Writes the picture of a view."""
    observation = _observed(name)
    if name == "camera":
        picture = Image.fromarray(observation["image"]).resize((336, 336), Image.Resampling.NEAREST)
    else:
        vectors = _vectors(observation)
        figure = new_figure(9.0 if vectors else 4.5, 4.0)
        left, *right = np.ravel(figure.subplots(1, 2 if vectors else 1))
        _draw_surroundings(left, name, observation)
        for axes in right:
            _draw_numbers(axes, vectors)
        figure.savefig(IMAGES / "views" / f"{name}.png", dpi=90)
        picture = Image.open(IMAGES / "views" / f"{name}.png").convert("RGB").quantize(64)
    picture.save(IMAGES / "views" / f"{name}.png", optimize=True)


def _observed(view: str) -> Any:
    with race_v0.parallel_env(num_kart=len(_STARTS), track=_TRACK, view=view) as env:
        observations, _ = env.reset(seed=_SEED, options={"start": _STARTS})
        return observations["kart_0"]


def _vectors(observation: Any) -> dict[str, Array]:
    """Returns the vectors of an observation by name; empty for the game's own entries."""
    if isinstance(observation, np.ndarray):
        return {"observation": observation}
    names = ("observation", "continuous", "discrete", "action_mask")
    return {name: observation[name] for name in names if name in observation}


def _draw_surroundings(axes: Any, name: str, observation: Any) -> None:
    """Draws the contents of an observation from above, with the kart facing up."""
    if name == "ground":
        _draw_ground(axes, observation)
        return
    if name == "racing":
        road, karts, items = _of_racing(observation)
    elif name == "full":
        road, karts, items = _of_dict(observation, np.asarray)
    else:
        road, karts, items = _of_dict(_observed("simple"), _from_polar)
    for start, end, width in road:
        axes.plot(*np.transpose([start, end]), color=_ROAD, lw=width, solid_capstyle="round")
    axes.scatter(*np.transpose(items), s=24, marker="s", color=_ITEM, label="items")
    axes.scatter(*np.transpose(karts), s=60, color=_KART, label="karts")
    axes.scatter(0, 0, s=110, marker="^", color=INK, label="the agent")
    axes.set(xlim=(-_REACH, _REACH), ylim=(-_REACH / 3, _REACH * 5 / 3), aspect="equal")
    axes.set_xlabel("to the right [m]", fontsize=9, color=INK)
    axes.set_ylabel("ahead [m]", fontsize=9, color=INK)
    axes.legend(fontsize=8, frameon=False, loc="lower left")
    style_axes(axes, f"{name}: what the agent sees")


def _of_dict(observation: Mapping[str, Any], to_points: Any) -> Surroundings:
    """Returns the surroundings in a dict observation."""
    starts, ends = (_flat(to_points(observation[f"paths_{end}"])) for end in ("start", "end"))
    road = [(start, end, 7.0) for start, end in zip(starts, ends, strict=True)]
    karts, items = (_flat(to_points(observation[f"{of}_position"])) for of in ("karts", "items"))
    return road, _present(karts), _present(items)


def _of_racing(vector: Array) -> Surroundings:
    """Returns the surroundings in the view ``racing``, which has points along the road's line."""
    marks = vector[PLACES["marks_direction"]].reshape(-1, 3) * MARKS[:, None]
    points = _flat(marks)
    road = [(start, end, 2.0) for start, end in pairwise(points)]
    return (
        road,
        _nearby(vector, "karts"),
        np.concatenate([_nearby(vector, "goods"), _nearby(vector, "bads")]),
    )


def _nearby(vector: Array, of: str) -> Array:
    nearness = vector[PLACES[f"{of}_nearness"]]
    directions = vector[PLACES[f"{of}_direction"]].reshape(-1, 3)[nearness > 0]
    return _flat(directions * (5.0 * (1.0 / nearness[nearness > 0] - 1.0))[:, None])


def _from_polar(rows: Array) -> Array:
    """Converts polar rows to points; the angles are those of x and y to z, from -pi to pi."""
    right, up, distance = np.transpose(rows)
    z = np.sign(np.cos(right)) * distance / np.sqrt(1 + np.tan(right) ** 2 + np.tan(up) ** 2)
    return np.transpose([z * np.tan(right), z * np.tan(up), z])


def _flat(points: Array) -> Array:
    """Returns x and z of points ``(N, 3)``."""
    return np.reshape(points, (-1, 3))[:, [0, 2]]


def _present(points: Array) -> Array:
    """Returns the points without zero padding."""
    return points[np.abs(points).sum(axis=1) > 0]


def _draw_ground(axes: Any, observation: Mapping[str, Any]) -> None:
    """Draws the grid of ground kinds: rows ahead, columns from left to right."""
    colors = [_GROUND_COLORS[kind] for kind in sorted(_GROUND_COLORS)]
    paint = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in colors], np.uint8)
    axes.imshow(paint[observation["ground_kind"]], origin="lower", aspect="auto")
    for kind, color in _GROUND_COLORS.items():
        axes.scatter([], [], marker="s", color=color, label=kind.name.lower())
    axes.legend(fontsize=8, frameon=False, bbox_to_anchor=(1.0, 1.0), loc="upper left")
    axes.set(xticks=[], yticks=[])
    axes.set_xlabel("left to right", fontsize=9, color=INK)
    axes.set_ylabel("rows ahead", fontsize=9, color=INK)
    style_axes(axes, "ground: what is beside the road")


def _draw_numbers(axes: Any, vectors: Mapping[str, Array]) -> None:
    """Draws the values of the vectors as bars: linear up to 1, logarithmic beyond."""
    start, ticks = 0, []
    for name, vector in vectors.items():
        places = np.arange(start, start + len(vector))
        axes.bar(places, vector, width=1.0, color=INK)
        ticks.append((start + len(vector) / 2, f"{name}\n{len(vector)} numbers"))
        start += len(vector) + 6
    axes.axhline(0, color=GRAY, lw=0.5)
    axes.set_xticks([place for place, _ in ticks], [text for _, text in ticks])
    axes.set_yscale("symlog", linthresh=1.0)
    axes.yaxis.set_major_formatter("{x:g}")
    style_axes(axes, "the same as numbers")


def main() -> None:
    """Draws the pictures."""
    parser = CommandParser(prog="python docs/_extensions/gallery.py", description=__doc__)
    parser.add_argument("--only", choices=("tracks", "views"), help="draw these pictures alone")
    only = parser.parse_args().only
    for folder in ("tracks", "views"):
        (IMAGES / folder).mkdir(parents=True, exist_ok=True)
    if only != "views":
        for track in SPLITS["all"]:
            draw_track(track)
            print(track, flush=True)
    if only != "tracks":
        for view in views():
            draw_view(view)


if __name__ == "__main__":
    main()
