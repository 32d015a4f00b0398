"""The racing view: a fixed-size observation of road, karts and items, and discrete actions."""

from stkzoo.wrappers.racing.features import LOOKS, MEANINGS, MIRROR, PARTS, PLACES, SIZE
from stkzoo.wrappers.racing.ground import GroundAhead, GroundTable, ground_table
from stkzoo.wrappers.racing.racing_line import (
    BatchedRacingLines,
    LineTables,
    line_tables,
    racing_line,
    racing_lines_of,
)
from stkzoo.wrappers.racing.surroundings import (
    ABSENT,
    RoadTable,
    Surroundings,
    road_line,
    surroundings_of,
)
from stkzoo.wrappers.racing.wrapper import (
    BRAKE,
    CHOICE_NAMES,
    CHOICES,
    PEDALS,
    RESCUE,
    STEERS,
    BatchedRacingView,
    RacingActions,
    RacingObservations,
    choices_of_action,
    controls_of_choices,
    racing_features,
)

__all__ = [
    "ABSENT",
    "BRAKE",
    "CHOICES",
    "CHOICE_NAMES",
    "LOOKS",
    "MEANINGS",
    "MIRROR",
    "PARTS",
    "PEDALS",
    "PLACES",
    "RESCUE",
    "SIZE",
    "STEERS",
    "BatchedRacingLines",
    "BatchedRacingView",
    "GroundAhead",
    "GroundTable",
    "LineTables",
    "RacingActions",
    "RacingObservations",
    "RoadTable",
    "Surroundings",
    "choices_of_action",
    "controls_of_choices",
    "ground_table",
    "line_tables",
    "racing_features",
    "racing_line",
    "racing_lines_of",
    "road_line",
    "surroundings_of",
]
