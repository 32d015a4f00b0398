"""The fixed split of the game's race tracks, so that "unseen tracks" means one thing.

The six test tracks are short and long ones, with and without forks, easy and hard for
simple drivers; nothing that learns may be trained or tuned on them. ``black_forest`` is a
training track although a lap takes four times as long as the shortest one's.
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

#: Track lists by name; ``track="train"`` draws one of them at every reset.
SPLITS = {
    "all": tuple(sorted(TRAIN_TRACKS + TEST_TRACKS)),
    "train": TRAIN_TRACKS,
    "test": TEST_TRACKS,
}
