"""The fixed split of the race tracks into training, validation and test tracks.

The six test tracks mix short and long tracks, with and without forks, easy and hard for simple
drivers. Do not train or tune on them. ``black_forest`` is a training track, although the
game's AI takes more than four times as long for its lap as for the shortest one.

The four validation tracks are **a subset of the training tracks**: ``"train"`` contains them, as
published results require, and ``"train_only"`` does not. To choose between drivers without the test
tracks, train on ``"train_only"`` and compare on ``"validation"``.
"""

from __future__ import annotations

__all__ = [
    "SPLITS",
    "TEST_TRACKS",
    "TRAIN_ONLY_TRACKS",
    "TRAIN_TRACKS",
    "VALIDATION_TRACKS",
    "split_of",
]

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

#: Training tracks for validation: narrow and wide, short and long, flat and hilly, with no, two and
#: three forks. Together they are about as hard as the test tracks.
VALIDATION_TRACKS = ("gran_paradiso_island", "minigolf", "ravenbridge_mansion", "snowtuxpeak")

#: The training tracks without the validation tracks.
TRAIN_ONLY_TRACKS = tuple(track for track in TRAIN_TRACKS if track not in VALIDATION_TRACKS)

#: Track names by split. With ``track="train"``, every reset draws a track of that split.
SPLITS = {
    "all": tuple(sorted(TRAIN_TRACKS + TEST_TRACKS)),
    "train": TRAIN_TRACKS,
    "train_only": TRAIN_ONLY_TRACKS,
    "validation": VALIDATION_TRACKS,
    "test": TEST_TRACKS,
}


def split_of(track: str) -> str:
    """Returns ``"test"``, ``"validation"`` or, for the other training tracks, ``"train"``."""
    if track in VALIDATION_TRACKS:
        return "validation"
    return "test" if track in TEST_TRACKS else "train"
