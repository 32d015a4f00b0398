"""Which numbers the plans of a run go by."""

from __future__ import annotations

import json
from pathlib import Path

from stkzoo.agents.planning import DriverParameters
from stkzoo.errors import ConfigError

from .arguments import ARGUMENTS

__all__ = ["NUMBERS", "numbers_of_run", "plan_numbers"]

#: Sets of numbers by name: those of the search on training tracks, and those from before it.
NUMBERS = {
    "found": DriverParameters(),
    "by-hand": DriverParameters(
        lane_changes=0,
        bump_cost=0.0,
        wheel_base=0.97,
        aim_distance=4.0,
        aim_time=0.35,
        margin=1.0,
        greatest_room=4.5,
        over_cost=20.0,
        late_time=0.3,
        late_cost=4.0,
        drift_speed=13.0,
        boost_worth=12.0,
        big_boost_worth=18.0,
        boost_wait_cost=1.0,
        small_nitro_worth=8.0,
        big_nitro_worth=20.0,
        banana_cost=15.0,
        item_radius=0.9,
        bad_item_radius=1.2,
        nitro_wait=2.2,
        nitro_turn=0.7,
        danger=1.0,
        caution_room=1.5,
    ),
}


def plan_numbers(name: str) -> DriverParameters:
    """The numbers of a name.

    Raises:
        ConfigError: there are none.
    """
    if name not in NUMBERS:
        raise ConfigError(f"plans {name!r} are unknown; expected one of {', '.join(NUMBERS)}")
    return NUMBERS[name]


def numbers_of_run(folder: Path) -> DriverParameters:
    """The numbers that a run learns with; today's, if the folder is none of a run.

    Raises:
        ConfigError: the run is of another version.
    """
    file = folder / ARGUMENTS
    if not file.exists():
        return DriverParameters()
    try:
        return DriverParameters(**json.loads(file.read_text())[-1]["rules"])
    except (KeyError, TypeError) as error:
        raise ConfigError(
            f"{str(file)!r} is of another version of stkzoo: the numbers of its plans are not "
            f"those of today ({error}); use that version, or learn anew"
        ) from None
