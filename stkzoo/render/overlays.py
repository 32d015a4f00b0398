"""Text over frames: the standings beside a map; labels, a top bar and a results card of videos."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from stkzoo.engine.snapshot import Snapshot
from stkzoo.render.palette import readable_on, rgb
from stkzoo.render.pictures import Picture, fitted_text, font_of, grid_of, pillow
from stkzoo.render.scene import Scene, clock, ordinal, standings

if TYPE_CHECKING:
    from PIL.Image import Image

#: One line of the end card: rank, name, color as ``"#rrggbb"``, finish time or status.
ResultRow = tuple[int, str, str, str]

_DARK, _CARD, _LINE = (14, 18, 25), (27, 34, 46), (52, 63, 82)
_TEXT, _FAINT = (240, 244, 250), (150, 162, 182)
#: Width of the narrowest frame with a panel [pixels].
_NARROWEST = 320


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
        left, bottom = column * tile[0], (row + 1) * tile[1]
        draw.rectangle([left, bottom - unit * 2, left + tile[0], bottom], fill=(*_DARK, 185))
        line, speed = lines[kart], max(float(snapshot.karts[kart]["speed"]), 0.0)
        label = line.rank, line.name, line.color, f"{line.detail}   {speed * 3.6:.0f} km/h"
        between = left + unit * 0.3, left + tile[0] - unit * 0.6
        _draw_row(draw, label, between, bottom - unit * 1.75, unit)
    title = f"{scene.title}   {clock(float(snapshot.header['time']))}"
    _draw_title(draw, title, width, unit)
    return np.asarray(image)


def _draw_row(
    draw: Any, row: ResultRow, between: tuple[float, float], top: float, unit: int
) -> None:
    """Draws a badge with the rank, the name, shortened if it does not fit, and the outcome.

    The rank is an ordinal, because plain numbers on the map are those of agents.

    Args:
        draw: Pillow's drawing.
        row: the row.
        between: left and right end [pixels].
        top: upper edge of the badge [pixels].
        unit: size of the font [pixels].
    """
    rank, name, color, outcome = row
    (left, right), tall, badge = between, unit * 1.5, unit * 2.4
    box = [left, top, left + badge, top + tall]
    draw.rounded_rectangle(box, radius=unit * 0.35, fill=rgb(color))
    middle = top + tall / 2
    ink, small = readable_on(color), font_of(int(unit * 0.85))
    draw.text((left + badge / 2, middle), ordinal(rank), ink, small, anchor="mm")
    font = font_of(unit, name)
    draw.text((right, middle), outcome, _FAINT, small, anchor="rm")
    left += badge + unit * 0.5
    name = fitted_text(name, font, right - small.getlength(outcome) - unit - left)
    draw.text((left, middle), name, _TEXT, font, anchor="lm")


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
        box = [width / 2 - half, y, width / 2 + half, y + unit * 2.1]
        draw.rounded_rectangle(box, radius=unit * 0.5, fill=(*_CARD, 235))
        between = width / 2 - half + unit * 0.3, width / 2 + half - unit
        _draw_row(draw, row, between, y + unit * 0.3, unit)
    if len(rows) > room:
        more = f"and {len(rows) - room} more"
        draw.text((width / 2, height - unit * 0.8), more, _FAINT, font_of(unit), anchor="mm")
    return np.asarray(image)


def panel_width(size: tuple[int, int]) -> int:
    """Returns the width of the panel in a frame [pixels]; 0 if it does not fit."""
    width, height = size
    if width < _NARROWEST or height < 120:
        return 0
    return min(int(width * 0.3), 360)


def draw_panel(picture: Image, scene: Scene, snapshot: Snapshot, left: int) -> None:
    """Draws the panel on the right side of a frame.

    Args:
        picture: the frame; changed in place.
        scene: the race.
        snapshot: current snapshot.
        left: left edge of the panel [pixels].
    """
    width, height = picture.size
    draw = pillow().ImageDraw.Draw(picture)
    draw.rectangle([left, 0, width, height], fill=_CARD)
    unit = max(9, min(height // 26, (width - left) // 12))
    pad = unit
    font = font_of(unit + 3, scene.title)
    title = fitted_text(scene.title, font, width - left - 2 * pad)
    draw.text((left + pad, pad), title, _TEXT, font)
    draw.text((left + pad, pad + unit * 1.7), _subtitle(scene, snapshot), _FAINT, font_of(unit))
    top = pad + unit * 3.6
    row = unit * 2.3
    lines = standings(scene, snapshot)
    room = int((height - top - pad) // row)
    for number, line in enumerate(lines[: max(room, 1)]):
        begin, end, y = left + pad, width - pad, top + number * row
        _draw_row(draw, (line.rank, line.name, line.color, line.detail), (begin, end), y, unit)
        bar, begin = y + unit * 1.5, begin + unit * 3
        draw.rectangle([begin, bar - 2, end, bar], fill=_LINE)
        done = begin + (end - begin) * line.progress
        draw.rectangle([begin, bar - 2, done, bar], fill=rgb(line.color))
    if len(lines) > room > 0:
        more = f"and {len(lines) - room} more"
        draw.text((left + pad, height - pad), more, _FAINT, font_of(unit), anchor="ls")


def _subtitle(scene: Scene, snapshot: Snapshot) -> str:
    leader = standings(scene, snapshot)[0]
    laps = scene.setup.laps
    lap = leader.detail if laps > 1 and not leader.has_finished else ""
    time = clock(float(snapshot.header["time"]))
    return f"{time}   {lap} of {laps}" if lap else time
