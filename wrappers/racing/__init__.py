"""The racing view: a fixed-size observation of road, karts and items, and discrete actions."""

from stkzoo.wrappers.racing.features import (
    CONTEST_MIRROR,
    CONTEST_SIZE,
    LOOKS,
    MEANINGS,
    MIRROR,
    OWN_PLACES,
    OWN_SIZE,
    PARTS,
    PLACES,
    SIZE,
)
from stkzoo.wrappers.racing.racing_line import ground_observer, racing_line
from stkzoo.wrappers.racing.surroundings import (
    ABSENT,
    Surroundings,
    racing_features,
    road_observer,
    surroundings_of,
)
from stkzoo.wrappers.racing.wrapper import (
    BRAKE,
    CHOICE_NAMES,
    CHOICES,
    PEDALS,
    RESCUE,
    STEERS,
    ContestObservations,
    RacingActions,
    RacingObservations,
    choices_of_action,
    controls_of_choices,
)

__all__ = [
    "ABSENT",
    "BRAKE",
    "CHOICES",
    "CHOICE_NAMES",
    "CONTEST_MIRROR",
    "CONTEST_SIZE",
    "LOOKS",
    "MEANINGS",
    "MIRROR",
    "OWN_PLACES",
    "OWN_SIZE",
    "PARTS",
    "PEDALS",
    "PLACES",
    "RESCUE",
    "SIZE",
    "STEERS",
    "ContestObservations",
    "RacingActions",
    "RacingObservations",
    "Surroundings",
    "choices_of_action",
    "controls_of_choices",
    "ground_observer",
    "racing_features",
    "racing_line",
    "road_observer",
    "surroundings_of",
]
__dir__ = __all__.copy
