"""Draws the maps of the tracks, and updates the rows of ``docs/reference/tracks.md``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from stkzoo import race_v0
from stkzoo._os import write_text
from stkzoo.engine.ground import Ground
from stkzoo.engine.track import TrackMap
from stkzoo.evaluation import AiTimes, load_ai_times
from stkzoo.names import GroundKind
from stkzoo.records import HUMAN_RECORDS
from stkzoo.tracks import SPLITS, split_of
from stkzoo.wrappers.racing import racing_line

DOCS = Path(__file__).parents[1]
PAGE, PICTURES = DOCS / "reference" / "tracks.md", DOCS / "images" / "tracks"
_SIZE, _COLORS = (300, 220), 32
_DIFFICULTIES = (0, 1, 2, 3)

#: Colors of the kinds of ground, of the edges of the driving line, and of the background.
_PAINT = {
    GroundKind.VOID: (60, 90, 200),
    GroundKind.GROUND: (185, 185, 185),
    GroundKind.SLOWED: (225, 200, 120),
    GroundKind.ZIPPER: (0, 160, 60),
    GroundKind.WALL: (200, 30, 30),
}
_EDGE, _LINE, _PAPER = (0, 0, 0), (255, 255, 255), (255, 255, 255)
#: Lateral extent of the ground on the map, and spacing of its samples [m].
_BESIDE, _SPACING = 12.0, 0.3


@dataclass(frozen=True, slots=True)
class Facts:
    """Length of a track [m], and numbers of its segments, forks and items."""

    length: float
    segments: int
    forks: int
    items: int


def survey(track: str) -> Facts:
    """Returns the facts of a track, and draws its maps."""
    env = race_v0.parallel_env(
        num_kart=1,
        track=track,
        max_paths=1,
        render_mode="rgb_array",
        render_backend="map",
        render_size=_SIZE,
    )
    try:
        env.reset(seed=0)
        road, snapshot = env.track_map, env.snapshot
        if road is None or snapshot is None:
            raise RuntimeError(f"no race on {track}")
        forks = sum(len(nodes) > 1 for nodes in road.successors)
        picture = Image.fromarray(env.render())
        _save(picture, track)
        if env.ground is not None:
            _save(ground_picture(road, env.ground), f"{track}-ground")
        return Facts(road.length, road.num_nodes, forks, len(snapshot.items))
    finally:
        env.close()


def _save(picture: Image.Image, name: str) -> None:
    picture.quantize(_COLORS).save(PICTURES / f"{name}.png", optimize=True)


def ground_picture(road: TrackMap, ground: Ground) -> Image.Image:
    """Draws the ground and the racing line from above, with the z axis up."""
    starts, ends = road.path_nodes[:, 0], road.path_nodes[:, 1]
    low = road.path_nodes[..., [0, 2]].min((0, 1)) - _BESIDE
    high = road.path_nodes[..., [0, 2]].max((0, 1)) + _BESIDE
    scale = (np.array(_SIZE) / (high - low)).min()
    picture = np.full((_SIZE[1], _SIZE[0], 3), _PAPER, np.uint8)
    paints = np.array([_PAINT[kind] for kind in sorted(_PAINT)], np.uint8)
    aside = np.arange(-_BESIDE, _BESIDE, _SPACING)
    for start, end, width in zip(starts, ends, road.path_width[:, 0], strict=True):
        along = end - start
        length = max(float(np.hypot(along[0], along[2])), 0.1)
        right = np.array([along[2], 0.0, -along[0]]) / length
        shares = np.linspace(0.0, 1.0, int(length / _SPACING) + 2)
        spots = start + shares[:, None, None] * along + aside[:, None] * right
        colors = paints[ground.at(spots).kind]
        colors[:, np.abs(np.abs(aside) - width / 2) < _SPACING] = _EDGE
        x, z = np.moveaxis((spots[..., [0, 2]] - low) * scale, -1, 0).astype(int)
        picture[np.clip(_SIZE[1] - 1 - z, 0, None), np.clip(x, 0, _SIZE[0] - 1)] = colors
    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image)
    for nodes in racing_line(road, ground).nodes[..., [0, 2]]:
        x, z = ((nodes - low) * scale).T
        draw.line([*zip(x.tolist(), (_SIZE[1] - 1 - z).tolist(), strict=True)], fill=_LINE)
    return image


def updated(page: str, facts: dict[str, Facts], times: AiTimes) -> str:
    """Returns the page with the current facts, the AI's times, and records of each track."""
    for track, row in facts.items():
        split = split_of(track)
        split = "**test**" if split == "test" else split
        row_of_facts = (
            f"| {track} | {split} | {row.length:.0f} | {row.segments} | {row.forks} | {row.items} "
            f"| {_times(track, False, times)} | {_times(track, True, times)} |"
        )
        laps, seconds = HUMAN_RECORDS[track].laps, HUMAN_RECORDS[track].seconds
        row_of_records = f"| {track} | {laps} | {seconds:.2f} | {seconds / laps:.2f} |"
        first, between, last = re.split(rf"^\| {track} \|.*\n", page, flags=re.MULTILINE)
        page = f"{first}{row_of_facts}\n{between}{row_of_records}\n{last}"
    return page


def _times(track: str, reverse: bool, times: AiTimes) -> str:
    return " / ".join(
        f"{times.of(track, reverse, difficulty).median:.1f}" for difficulty in _DIFFICULTIES
    )


def main() -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    facts = {track: survey(track) for track in SPLITS["all"]}
    write_text(PAGE, updated(PAGE.read_text("utf-8"), facts, load_ai_times()))


if __name__ == "__main__":
    main()
