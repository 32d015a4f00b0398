"""The human world records of the race tracks, in the game's time trial.

The times and numbers of laps are those of the replays in the sources of SuperTuxKart 1.5. Each
record is a whole race from the standing start, forward, at difficulty 3, mostly with the kart
*pidgin*. The players use the start boost, which karts of agents do not get, and shortcuts.
"""

from __future__ import annotations

from dataclasses import dataclass

from stkzoo._schema import Positive, Whole

__all__ = ["HUMAN_RECORDS", "RECORD_DIFFICULTY", "RECORD_KART", "HumanRecord"]

#: Difficulty of all records, and the kart of most of them.
RECORD_DIFFICULTY, RECORD_KART = 3, "pidgin"


@dataclass(frozen=True, slots=True)
class HumanRecord:
    """The human world record of a track.

    Attributes:
        seconds: duration of the race [s].
        laps: number of laps of the race.
    """

    seconds: Positive
    laps: Whole


#: The records by track.
HUMAN_RECORDS = {
    "abyss": HumanRecord(100.46, 3),
    "black_forest": HumanRecord(129.22, 2),
    "candela_city": HumanRecord(82.37, 3),
    "cocoa_temple": HumanRecord(87.14, 3),
    "cornfield_crossing": HumanRecord(104.36, 3),
    "fortmagma": HumanRecord(80.80, 3),
    "gran_paradiso_island": HumanRecord(101.67, 3),
    "hacienda": HumanRecord(90.66, 3),
    "lighthouse": HumanRecord(86.92, 4),
    "mines": HumanRecord(92.34, 3),
    "minigolf": HumanRecord(76.86, 4),
    "olivermath": HumanRecord(57.08, 6),
    "ravenbridge_mansion": HumanRecord(98.29, 3),
    "sandtrack": HumanRecord(94.26, 3),
    "scotland": HumanRecord(90.92, 3),
    "snowmountain": HumanRecord(86.50, 3),
    "snowtuxpeak": HumanRecord(79.79, 3),
    "stk_enterprise": HumanRecord(107.36, 3),
    "volcano_island": HumanRecord(112.86, 2),
    "xr591": HumanRecord(94.88, 3),
    "zengarden": HumanRecord(74.41, 4),
}
