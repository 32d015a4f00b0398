"""Builds the page of the gallery; ``gallery.py`` draws its pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from stkzoo.tracks import SPLITS
from stkzoo.views import views

IMAGES = Path(__file__).parents[1] / "images"


def pages() -> dict[str, str]:
    """Returns the text of the page."""
    lines = (
        "# Gallery",
        "",
        "## Tracks",
        "",
        "Each track as the game draws it, and an animated map of one lap, four times as",
        "fast as the race. [Tracks](tracks.md) lists lengths, items and lap times.",
        "",
        *_grid(_track_cards()),
        "## Views",
        "",
        "What one agent sees at the same moment in each view: from above, and as numbers where",
        "the observation is a vector. [Views entry by entry](views/index.md) names every",
        "number.",
        "",
        *_grid(_view_cards()),
    )
    return {"reference/gallery.md": "\n".join(lines)}


def _grid(cards: Iterator[tuple[str, list[str]]]) -> Iterator[str]:
    yield from ("::::{grid} 1 1 2 2", ":gutter: 3", "")
    for title, lines in cards:
        yield from (f":::{{grid-item-card}} {title}", *lines, ":::", "")
    yield from ("::::", "")


def _track_cards() -> Iterator[tuple[str, list[str]]]:
    for track in SPLITS["all"]:
        name = f"../images/tracks/{track}"
        frame = f"![Karts on {track}]({name}-frame.webp)"
        if not (IMAGES / "tracks" / f"{track}-frame.webp").exists():
            frame = "The game crashes when it draws this track; the map and the race itself work."
        yield track, [frame, "", f"![One lap of {track} on the map]({name}-lap.svg)"]


def _view_cards() -> Iterator[tuple[str, list[str]]]:
    for view in views().values():
        picture = f"![What an agent sees in the view {view.name}](../images/views/{view.name}.png)"
        text = view.description.replace("``", "`")
        yield f"[{view.name}](views/{view.name}.md)", [picture, "", text]
