"""Overlays of videos: labels, a top bar, and a results card."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.engine.snapshot import Snapshot
from stkzoo.render.palette import readable_on, rgb
from stkzoo.render.pictures import fitted_text, font_of, grid_of, pillow
from stkzoo.render.scene import RaceStanding, Scene, clock, standings

Picture = npt.NDArray[np.uint8]

#: One line of the end card: rank, name, color as ``"#rrggbb"``, finish time or status.
ResultRow = tuple[int, str, str, str]

_DARK, _CARD, _TEXT, _FAINT = (14, 18, 25), (27, 34, 46), (240, 244, 250), (150, 162, 182)
_MEDALS = {1: "#ffd34d", 2: "#cfd8e3", 3: "#e0a371"}


def with_labels(
    picture: Picture, scene: Scene, snapshot: Snapshot, karts: Sequence[int]
) -> Picture:
    """Adds rank, name, lap and speed to each camera tile, and the race's time to the frame.

    Args:
        picture: tiles from :func:`stkzoo.render.pictures.tiled`, ``(H, W, 3)`` uint8.
        scene: the race.
        snapshot: current snapshot.
        karts: kart index of each tile.
    """
    image = pillow().Image.fromarray(picture)
    draw = pillow().ImageDraw.Draw(image, "RGBA")
    height, width = picture.shape[:2]
    columns, rows = grid_of(len(karts))
    tile = width // columns, height // rows
    unit = max(9, min(tile[1] // 18, tile[0] // 18))
    lines = {line.kart: line for line in standings(scene, snapshot)}
    for number, kart in enumerate(karts):
        row, column = divmod(number, columns)
        place = column * tile[0], row * tile[1]
        speed = float(snapshot.karts[kart]["speed"])
        _draw_label(draw, lines[kart], speed, place, tile, unit)
    title = f"{scene.title}   {clock(float(snapshot.header['time']))}"
    _draw_title(draw, title, width, unit)
    return np.asarray(image)


def _draw_label(
    draw: Any,
    line: RaceStanding,
    speed: float,
    place: tuple[int, int],
    tile: tuple[int, int],
    unit: int,
) -> None:
    """Draws the bar at the bottom of a tile: rank in the kart's color, name, lap and speed."""
    left, bottom = place[0], place[1] + tile[1]
    top = bottom - unit * 2
    draw.rectangle([left, top, left + tile[0], bottom], fill=(*_DARK, 185))
    draw.rectangle([left, top, left + unit * 2, bottom], fill=rgb(line.color))
    middle = (top + bottom) / 2
    ink = readable_on(line.color)
    draw.text((left + unit, middle), str(line.rank), ink, font_of(unit + 3), anchor="mm")
    font, right = font_of(unit), left + tile[0] - unit * 0.6
    detail = f"{line.detail}   {max(speed, 0.0) * 3.6:.0f} km/h"
    draw.text((right, middle), detail, _FAINT, font, anchor="rm")
    begin = left + unit * 2.6
    room, font = right - font.getlength(detail) - unit - begin, font_of(unit, line.name)
    name = fitted_text(line.name, font, room)
    draw.text((begin, middle), name, _TEXT, font, anchor="lm")


def _draw_title(draw: Any, title: str, width: int, unit: int) -> None:
    font = font_of(unit, title)
    half = font.getlength(title) / 2 + unit
    box = [width / 2 - half, -unit, width / 2 + half, unit * 2]
    draw.rounded_rectangle(box, radius=unit, fill=(*_DARK, 185))
    draw.text((width / 2, unit), title, _TEXT, font, anchor="mm")


def end_card(
    title: str, subtitle: str, rows: Sequence[ResultRow], behind: Picture | None, size: Any
) -> Picture:
    """Returns the results as the last frame of a video.

    Args:
        title: name of the track.
        subtitle: line below the title.
        rows: results, best first; a line counts those that do not fit.
        behind: last frame of the race, as a dimmed background; ``None`` for no background.
        size: width and height [pixels].
    """
    images, drawing = pillow().Image, pillow().ImageDraw
    width, height = size
    image = images.new("RGB", (width, height), _DARK)
    if behind is not None:
        image = images.blend(images.fromarray(behind).resize((width, height)), image, 0.78)
    draw = drawing.Draw(image, "RGBA")
    unit = max(9, min(height // 24, width // 30))
    top = unit * 2
    font = font_of(unit * 2, title)
    title = fitted_text(title, font, width - 2 * unit)
    draw.text((width / 2, top), title, _TEXT, font, anchor="mm")
    draw.text((width / 2, top + unit * 2), subtitle, _FAINT, font_of(unit), anchor="mm")
    half = min(width * 0.44, unit * 13)
    first, step = top + unit * 3.8, unit * 2.5
    room = max(1, int((height - first - unit * 1.5) // step))
    for number, row in enumerate(rows[:room]):
        y = first + number * step
        _draw_result(draw, row, width / 2 - half, width / 2 + half, y, unit)
    if len(rows) > room:
        more = f"and {len(rows) - room} more"
        draw.text((width / 2, height - unit * 0.8), more, _FAINT, font_of(unit), anchor="mm")
    return np.asarray(image)


def _draw_result(
    draw: Any, row: ResultRow, left: float, right: float, top: float, unit: int
) -> None:
    rank, name, color, outcome = row
    high = unit * 2.1
    draw.rounded_rectangle([left, top, right, top + high], radius=unit * 0.5, fill=(*_CARD, 235))
    bar = [left, top, left + unit * 0.7, top + high]
    draw.rounded_rectangle(bar, radius=unit * 0.35, fill=rgb(color))
    middle = top + high / 2
    ink = rgb(_MEDALS[rank]) if rank in _MEDALS else _FAINT
    draw.text((left + unit * 2, middle), str(rank), ink, font_of(int(unit * 1.3)), anchor="mm")
    begin, end, font = left + unit * 3.4, right - unit, font_of(int(unit * 1.1), name)
    draw.text((end, middle), outcome, _FAINT, font_of(unit), anchor="rm")
    name = fitted_text(name, font, end - font_of(unit).getlength(outcome) - unit - begin)
    draw.text((begin, middle), name, _TEXT, font, anchor="lm")
