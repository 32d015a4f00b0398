"""Writes ``docs/reference/tracks.md``: facts, the AI's times and two maps of each track.

``python -m benchmarks.track_atlas`` draws the maps and writes the page. With ``--measure FOLDER``
it first races the game's AI on all tracks (840 races, saved in the folder; an interrupted run
resumes) and stores its times where ``stkzoo benchmark`` reads them.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from stkzoo import race_v0
from stkzoo._arguments import CommandParser
from stkzoo._os import write_text
from stkzoo.engine.ground import Ground
from stkzoo.engine.track import TrackMap
from stkzoo.evaluation import AiTimes, BatchProgress, load_ai_times, measure_ai_times
from stkzoo.names import GroundKind
from stkzoo.records import HUMAN_RECORDS, RECORD_DIFFICULTY, RECORD_KART
from stkzoo.tracks import SPLITS, split_of
from stkzoo.wrappers.racing import racing_line

ROOT = Path(__file__).parent.parent
PAGE, PICTURES = ROOT / "docs" / "reference" / "tracks.md", ROOT / "docs" / "images" / "tracks"
AI_TIMES = Path(str(files("stkzoo.evaluation.benchmark") / "ai_times.json"))
_SIZE, _COLORS, _COLUMNS = (300, 220), 32, 3
_DIFFICULTIES = (0, 1, 2, 3)

_HEAD = """\
# Tracks

The game has 21 race tracks. Each can also be driven in reverse (`reverse=True`).
`python -m benchmarks.track_atlas` writes this page.

## Training, validation and test

`track="train"`, `"validation"` and `"test"` draw a track from a fixed list
([`stkzoo/tracks.py`](../../stkzoo/tracks.py)).

| split | tracks | use |
| :-- | --: | :-- |
| `train` | 15 | train and tune drivers |
| `validation` | 4 of these 15 | choose between drivers; compare them as often as you like |
| `train_only` | the other 11 | train drivers that you compare on the validation tracks |
| `test` | 6 | report the result of a finished driver, once |

**The validation tracks are training tracks too:** `train` contains them, because published results
and stkzoo's own drivers use them. To leave them out of training, pass `--track train_only`. The
four differ from each other: *minigolf* is the narrowest track with the most bends, *snowtuxpeak* is
hilly without forks, *ravenbridge_mansion* is long and hilly with two forks, and
*gran_paradiso_island* is wide with three forks. Together, they are about as hard as the test
tracks: on the validation tracks, the plans without learning take 0.87 of the AI's time alone and
0.94 against four AI karts; on the test tracks, the *heuristic* takes 0.88 and 0.95.

Do not train or tune on the six test tracks, in either direction. Like the training tracks, they
are mixed: short and long, with and without forks, with few and many items, easy and hard for
drivers that follow the line. A [log](../explanation/research-log.md#visits-to-the-test-tracks)
lists every benchmark on them. *black_forest*, the longest track, is a training track; a lap there
takes as long as two laps on most others.

"""

_ABOUT = """\
*Segments* are parts of the driving line; *forks* are segments with more than one successor.
*Items* are those on the track at the start. *AI times* are the medians in seconds at difficulty
0 / 1 / 2 / 3, of {karts} karts in races of five AI karts.
[`stkzoo benchmark`](benchmark-protocol.md) divides by them. The best and worst times are in
`stkzoo/evaluation/benchmark/ai_times.json`.

The AI is faster at higher difficulties partly because all karts, including those of agents, have
stronger engines.

"""

_RECORDS = """\

## Human records

The world records of the game's time trial, from the replays in the sources of SuperTuxKart 1.5
([`stkzoo/records.py`](../../stkzoo/records.py)). Conditions:

- Each record is a whole race from the standing start, forward, at difficulty {difficulty}.
- The track has no item boxes, and the kart starts with one zipper per lap.
- Most players drive the kart *{kart}*.
- Players use the start boost, which karts of agents do not get, and shortcuts.

*Per lap* is the record divided by its laps. `mode="time_trial"` sets the mode, and
`stkzoo benchmark AGENT --time-trial` [compares an agent](benchmark-protocol.md#time-trials) with
the records.

"""

_GROUND = """\

## Ground

`env.ground` gives the kind of ground at any place of the track, read from the game's meshes. The
driving line (between the black lines) only approximates it. Moving objects are not included. The
white line is the [racing line](environment.md#the-racing-line) of the view `ground`.

| color | ground |
| --- | --- |
| gray | drivable |
| sand | slows karts |
| green | zipper: speeds karts up |
| red | wall |
| blue | nothing, or a surface that triggers a rescue |

```python
from stkzoo import race_v0

env = race_v0.parallel_env(track="minigolf")
env.reset(seed=0)
places = env.snapshot.karts["location"]  # (K, 3) [m], world frame
env.ground.at(places).kind  # (K,): numbers of stkzoo.GroundKind
env.close()
```

"""

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


def page(facts: dict[str, Facts], times: AiTimes) -> str:
    """Returns the whole page."""
    karts = next(iter(times.by_race.values())).karts
    versions = ", ".join(f"{name} {number}" for name, number in times.versions.items())
    return "".join(
        (
            _HEAD,
            _ABOUT.format(karts=karts),
            _table(facts, times),
            f"\n{_unfinished(times)} Measured with {versions}.\n",
            _RECORDS.format(difficulty=RECORD_DIFFICULTY, kart=RECORD_KART),
            _records(),
            "\n## Maps\n\n",
            "The kart is at the start and points ahead. Squares are gift boxes; discs are\n",
            "bananas, nitro and other items. Brighter road is higher.\n\n",
            _maps(list(facts), ""),
            _GROUND,
            _maps(list(facts), "-ground"),
        )
    )


def _table(facts: dict[str, Facts], times: AiTimes) -> str:
    lines = [
        "| track | split | length [m] | segments | forks | items | AI times, forwards | reversed |",
        "| :-- | :-- | --: | --: | --: | --: | --: | --: |",
    ]
    for track, found in facts.items():
        split = split_of(track)
        split = "**test**" if split == "test" else split
        lines.append(
            f"| {track} | {split} | {found.length:.0f} | {found.segments} | {found.forks} | "
            f"{found.items} | {_times(track, False, times)} | {_times(track, True, times)} |"
        )
    return "\n".join(lines) + "\n"


def _records() -> str:
    lines = ["| track | laps | record [s] | per lap [s] |", "| :-- | --: | --: | --: |"]
    lines += [
        f"| {track} | {record.laps} | {record.seconds:.2f} | {record.seconds / record.laps:.2f} |"
        for track, record in HUMAN_RECORDS.items()
    ]
    return "\n".join(lines) + "\n"


def _times(track: str, reverse: bool, times: AiTimes) -> str:
    return " / ".join(
        f"{times.of(track, reverse, difficulty).median:.1f}" for difficulty in _DIFFICULTIES
    )


def _unfinished(times: AiTimes) -> str:
    karts = sum(time.karts for time in times.by_race.values())
    lost = {key: time.karts - time.finished for key, time in times.by_race.items()}
    places = [
        f"{count} on {track}{' reversed' if reverse else ''} at difficulty {difficulty}"
        for (track, reverse, difficulty), count in lost.items()
        if count
    ]
    if not places:
        return f"All {karts} karts finished."
    return f"{sum(lost.values())} of {karts} karts did not finish: {', '.join(places)}."


def _maps(tracks: list[str], which: str) -> str:
    blank = "| " + " | ".join([" "] * _COLUMNS) + " |\n| " + " | ".join([":-:"] * _COLUMNS) + " |\n"
    rows = [tracks[first : first + _COLUMNS] for first in range(0, len(tracks), _COLUMNS)]
    cells = [
        [f"![{track}](../images/tracks/{track}{which}.png)<br>{track}" for track in row]
        for row in rows
    ]
    return blank + "".join(f"| {' | '.join(row)} |\n" for row in cells)


def _tell(progress: BatchProgress) -> None:
    if progress.last is not None:
        last = progress.last
        way = "reversed" if last.reverse else "forward"
        print(
            f"{progress.done} of {progress.total}: {last.track} {way} at {last.difficulty}",
            flush=True,
        )


def main() -> None:
    parser = CommandParser(prog="python -m benchmarks.track_atlas", description=__doc__)
    parser.add_argument("--measure", metavar="FOLDER", help="measure the AI's times first")
    parser.add_argument("--jobs", type=int, help="parallel races")
    arguments = parser.parse_args()
    if arguments.measure:
        times = measure_ai_times(arguments.measure, jobs=arguments.jobs, on_race=_tell)
        write_text(AI_TIMES, times.to_json() + "\n")
    PICTURES.mkdir(parents=True, exist_ok=True)
    facts = {track: survey(track) for track in SPLITS["all"]}
    write_text(PAGE, page(facts, load_ai_times()))


if __name__ == "__main__":
    main()
