"""The standings panel beside a map, and the lines of text over a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from stkzoo.engine.snapshot import Snapshot
from stkzoo.render.palette import readable_on, rgb
from stkzoo.render.pictures import fitted_text, font_of, pillow
from stkzoo.render.scene import RaceStanding, Scene, clock, standings

if TYPE_CHECKING:
    from PIL.Image import Image

_PANEL, _LINE, _TEXT, _FAINT = (27, 34, 46), (52, 63, 82), (233, 238, 245), (148, 160, 180)
_NARROWEST = 320


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
    draw.rectangle([left, 0, width, height], fill=_PANEL)
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
        _draw_line(draw, line, left + pad, width - pad, top + number * row, unit)
    if len(lines) > room > 0:
        more = f"and {len(lines) - room} more"
        draw.text((left + pad, height - pad), more, _FAINT, font_of(unit), anchor="ls")


def _subtitle(scene: Scene, snapshot: Snapshot) -> str:
    leader = standings(scene, snapshot)[0]
    laps = scene.setup.laps
    lap = leader.detail if laps > 1 and not leader.has_finished else ""
    time = clock(float(snapshot.header["time"]))
    return f"{time}   {lap} of {laps}" if lap else time


def _draw_line(
    draw: Any, line: RaceStanding, left: float, right: float, top: float, unit: int
) -> None:
    """Draws a badge with the rank, the name, the lap or time, and a progress bar."""
    color, ink = rgb(line.color), readable_on(line.color)
    badge = unit * 1.5
    draw.rounded_rectangle([left, top, left + badge, top + badge], radius=unit * 0.35, fill=color)
    middle = top + badge / 2
    draw.text((left + badge / 2, middle), str(line.rank), ink, font_of(unit), anchor="mm")
    small = font_of(int(unit * 0.85))
    detail = draw.textlength(line.detail, small)
    draw.text((right, middle - unit * 0.2), line.detail, _FAINT, small, anchor="rm")
    begin = left + badge + unit * 0.5
    font = font_of(unit, line.name)
    name = fitted_text(line.name, font, right - detail - unit * 0.4 - begin)
    draw.text((begin, middle - unit * 0.2), name, _TEXT, font, anchor="lm")
    bar = top + badge
    draw.rectangle([begin, bar - 2, right, bar], fill=_LINE)
    draw.rectangle([begin, bar - 2, begin + (right - begin) * line.progress, bar], fill=color)
