"""The fixed split of the race tracks into training and test tracks.

The six test tracks mix short and long tracks, with and without forks, easy and hard for simple
drivers. Do not train or tune on them. ``black_forest`` is a training track, although the
game's AI takes more than four times as long for its lap as for the shortest one.
"""

from __future__ import annotations

__all__ = ["SPLITS", "TEST_TRACKS", "TRAIN_TRACKS"]

TEST_TRACKS = ("cocoa_temple", "fortmagma", "sandtrack", "scotland", "xr591", "zengarden")

TRAIN_TRACKS = (
    "abyss",
    "black_forest",
    "candela_city",
    "cornfield_crossing",
    "gran_paradiso_island",
    "hacienda",
    "lighthouse",
    "mines",
    "minigolf",
    "olivermath",
    "ravenbridge_mansion",
    "snowmountain",
    "snowtuxpeak",
    "stk_enterprise",
    "volcano_island",
)

#: Track names by split. With ``track="train"``, every reset draws a track of that split.
SPLITS = {
    "all": tuple(sorted(TRAIN_TRACKS + TEST_TRACKS)),
    "train": TRAIN_TRACKS,
    "test": TEST_TRACKS,
}
