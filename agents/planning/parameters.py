"""The parameters of the planner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, fields
from typing import Annotated, Any

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Meta

from stkzoo._reading import Unreadable
from stkzoo._schema import Count, Whole

_LARGEST = 1e6


@dataclass(frozen=True, slots=True)
class DriverParameters:
    """Parameters of plans and of their worth, which is in meters of distance.

    Attributes:
        wheel_base: wheel base, which relates the steering angle to the curvature [m].
        aim_distance: distance ahead at which a kart aims at standstill [m].
        aim_time: additional aiming distance per speed [s].
        margin: distance to keep from the edge of the road [m].
        lane_changes: number of lanes between which plans change; 0 for none.
        greatest_room: maximum distance from the middle of the road [m].
        over_cost: cost of each second spent one meter beyond that distance [m].
        late_time: time for which a plan continues straight after its end [s].
        late_cost: cost per meter beyond the edge of the road at that time [m].
        angle_cost: cost of ending at an angle of one radian to the road [m].
        drift_speed: minimum speed at which a drift begins [m/s].
        brake_speed: minimum speed at which a plan brakes [m/s]; at lower speeds the brake reverses.
        boost_worth: worth of the boost of a short drift [m].
        big_boost_worth: worth of the boost of a long drift [m].
        boost_wait_cost: cost of each second until the boost begins [m].
        box_worth: worth of a bonus box [m].
        second_box_worth: worth of a bonus box to a kart that has a powerup [m].
        small_nitro_worth: worth of a small nitro bottle [m].
        big_nitro_worth: worth of a big nitro bottle [m].
        banana_cost: cost of a banana [m].
        gum_cost: cost of bubble gum [m].
        item_radius: distance within which a kart hits a good item [m].
        bad_item_radius: distance within which a kart hits a bad item [m].
        nitro_wait: minimum time between two bursts of nitro [s].
        nitro_speed: minimum speed for nitro [m/s].
        nitro_turn: maximum turn for nitro [fraction of full lock].
        danger: maximum cost beyond the edge of the road for nitro and powerups [m].
        straight_angle: maximum turn of the road ahead for firing a powerup [rad].
        straight_time: time ahead over which that turn is measured [s].
        straight_aim: maximum angle of the kart to the road for firing a powerup [rad].
        switch_reach: the switch is kept while an item is nearer than this [m].
        fire_every: minimum number of steps between two shots.
        crash_drop: loss of speed in a step that counts as a crash [m/s].
        caution_time: time after a crash in which a kart stays near the middle of the road [s].
        caution_room: maximum distance from the middle in that time [m].
        stuck_speed: a kart below this speed stands still [m/s].
        stuck_time: time of standing still after which a kart reverses or calls the rescue [s].
        crawl_speed: a kart below this speed crawls [m/s].
        crawl_time: time of crawling after which a kart counts as stuck [s].
        reverse_time: duration of reversing [s].
        rescue_reverses: number of reverses before a kart calls the rescue.
        rescued_reverses: additional number of reverses if the last rescue did not help.
        free_time: time of driving after which a kart is no longer stuck [s].
        lost_room: a kart farther than this beyond the edge of the road is lost [m].
        lost_time: time of being lost after which a kart calls the rescue [s].
        bump_cost: cost of hitting a slower kart ahead, per m/s of speed difference [m]; 0 ignores
            other karts.
        bump_width: a kart within this distance of the path is hit [m].
        turn_hold: number of steps for which a steering offset from the plan holds.
        learned_motion: whether plans are simulated with the network of :mod:`.motion`; otherwise,
            karts drive arcs at constant speed.
        racing_line: whether plans follow the racing line, which agents see in the view ``ground``;
            otherwise, they follow the driving line.
    """

    wheel_base: float = 0.89
    aim_distance: float = 4.67
    aim_time: float = 0.31
    margin: float = 1.13
    lane_changes: Annotated[int, Meta(ge=0, le=20)] = 4
    greatest_room: float = 4.37
    over_cost: float = 17.4
    late_time: float = 0.05
    late_cost: float = 2.57
    angle_cost: float = 4.0
    drift_speed: float = 14.2
    brake_speed: float = 10.0
    boost_worth: float = 11.0
    big_boost_worth: float = 22.9
    boost_wait_cost: float = 0.98
    box_worth: float = 4.0
    second_box_worth: float = 1.2
    small_nitro_worth: float = 9.01
    big_nitro_worth: float = 19.7
    banana_cost: float = 16.2
    gum_cost: float = 15.0
    item_radius: float = 0.84
    bad_item_radius: float = 1.01
    nitro_wait: float = 2.87
    nitro_speed: float = 8.0
    nitro_turn: float = 0.84
    danger: float = 1.77
    straight_angle: float = 0.35
    straight_time: float = 1.2
    straight_aim: float = 0.3
    switch_reach: float = 30.0
    fire_every: Whole = 3
    crash_drop: float = 6.0
    caution_time: float = 3.0
    caution_room: float = 1.76
    stuck_speed: float = 1.5
    stuck_time: float = 0.4
    crawl_speed: float = 6.0
    crawl_time: float = 2.5
    reverse_time: float = 1.0
    rescue_reverses: Count = 0
    rescued_reverses: Count = 1
    free_time: float = 6.0
    lost_room: float = 6.0
    lost_time: float = 1.0
    bump_cost: float = 1.0
    bump_width: float = 1.5
    turn_hold: Whole = 1
    learned_motion: bool = False
    racing_line: bool = False

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DriverParameters:
        """Returns the parameters in a JSON object; missing ones have their default.

        Raises:
            Unreadable: the value is not an object, or a parameter is unknown or invalid.
        """
        parameters = msgspec.convert(values, cls)
        if unknown := set(values) - {entry.name for entry in fields(cls)}:
            raise Unreadable(f"this version of stkzoo has no parameter {min(unknown)[:60]!r}")
        for name, value in asdict(parameters).items():
            if abs(value) > _LARGEST:
                raise Unreadable(f"{name} is {value}, expected at most {_LARGEST:,.0f}")
        return parameters


def rule_numbers(parameters: DriverParameters) -> npt.NDArray[np.float64]:
    """Returns the parameters in the form that the extension expects, ``(50,)`` float64."""
    return np.array(astuple(parameters), np.float64)
