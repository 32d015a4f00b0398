"""The parameters of a run's plans."""

from __future__ import annotations

import json
from pathlib import Path

from stkzoo.agents.planning import DriverParameters
from stkzoo.errors import ConfigError

from .arguments import ARGUMENTS

__all__ = ["PLAN_PARAMETERS", "plan_parameters", "run_parameters"]

#: By name: those that a search on training tracks found, and those before it.
PLAN_PARAMETERS = {
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


def plan_parameters(name: str) -> DriverParameters:
    """The parameters of a name.

    Raises:
        ConfigError: the name is unknown.
    """
    if name not in PLAN_PARAMETERS:
        expected = ", ".join(PLAN_PARAMETERS)
        raise ConfigError(f"plans {name!r} are unknown; expected one of {expected}")
    return PLAN_PARAMETERS[name]


def run_parameters(folder: Path) -> DriverParameters:
    """The parameters of a run's plans; the default ones if the folder has no run.

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
            f"{str(file)!r} is of another version of stkzoo: the parameters of its plans have "
            f"changed ({error}); use that version, or start a new run"
        ) from None
