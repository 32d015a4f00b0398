"""The parameters of the planner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Annotated, Any

from stkzoo._reading import Unreadable
from stkzoo._schema import Count, Whole, Within, typed

_LARGEST = 1e6


@dataclass(frozen=True, slots=True)
class DriverParameters:
    """How plans are made and weighed. The worth of a plan is in metres of way.

    Attributes:
        wheel_base: turns the maximum steering angle into a curve [m].
        aim_distance: how far ahead a kart aims at standstill [m].
        aim_time: how much farther it aims for each m/s [s].
        margin: distance to keep from the edge of the road [m].
        lane_changes: number of lanes between which plans change; 0 for none.
        greatest_room: maximum distance from the middle of the road [m].
        over_cost: cost of each second spent one metre beyond that distance [m].
        late_time: a plan goes straight on for this time after its end [s].
        late_cost: cost of each metre beyond the edge of the road at that time [m].
        angle_cost: cost of ending at an angle of one radian to the road [m].
        drift_speed: no drift begins below this speed [m/s].
        brake_speed: no plan brakes below this speed, where the brake drives backwards [m/s].
        boost_worth: worth of the boost of a short drift [m].
        big_boost_worth: worth of the boost of a long drift [m].
        boost_wait_cost: cost of each second until the boost begins [m].
        box_worth: worth of a bonus box [m].
        second_box_worth: worth of a bonus box to a kart that has a power-up [m].
        small_nitro_worth: worth of a small bottle of nitro [m].
        big_nitro_worth: worth of a big bottle [m].
        banana_cost: cost of a banana [m].
        gum_cost: cost of bubble gum [m].
        item_radius: a kart hits a good item that it passes within this distance [m].
        bad_item_radius: the same for a bad item [m].
        nitro_wait: minimum time between two bursts of nitro [s].
        nitro_speed: minimum speed for nitro [m/s].
        nitro_turn: maximum turn for nitro [share of full lock].
        danger: maximum cost beyond the edge of the road for nitro and power-ups [m].
        straight_angle: power-ups are fired where the road turns less than this [rad]
        straight_time: within this time [s],
        straight_aim: by karts at less than this angle to the road [rad].
        switch_reach: the switch is kept while an item is nearer than this [m].
        fire_every: minimum number of steps between two shots.
        crash_drop: a kart that loses this much speed in a step has hit something [m/s].
        caution_time: after that it stays near the middle of the road for this time [s],
        caution_room: within this distance [m].
        stuck_speed: a kart below this speed stands still [m/s].
        stuck_time: it backs out, or calls the rescue, after standing for this time [s].
        crawl_speed: a kart below this speed crawls [m/s].
        crawl_time: after crawling for this time it is stuck too [s].
        reverse_time: how long it backs out [s].
        rescue_reverses: how often it backs out before it calls the rescue.
        rescued_reverses: how much more often if the last rescue did not help.
        free_time: after driving for this time it is free again [s].
        lost_room: a kart farther than this beyond the edge of the road [m]
        lost_time: for this time is lost and calls the rescue [s].
        bump_cost: cost of running into a slower kart ahead for each m/s of difference [m];
            0 ignores other karts.
        bump_width: a kart is hit if its middle is within this distance of the way [m].
    """

    wheel_base: float = 0.89
    aim_distance: float = 4.67
    aim_time: float = 0.31
    margin: float = 1.13
    lane_changes: Annotated[int, Within(0, 20)] = 4
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

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DriverParameters:
        """The parameters of a JSON object; those that it leaves out are the default ones.

        Raises:
            Unreadable: it is no object, or has other parameters or invalid values.
        """
        parameters = typed(cls, values)
        if unknown := set(values) - {entry.name for entry in fields(cls)}:
            raise Unreadable(f"this version of stkzoo has no parameter {min(unknown)[:60]!r}")
        for name, value in asdict(parameters).items():
            if abs(value) > _LARGEST:
                raise Unreadable(f"is {value}, expected at most {_LARGEST:,.0f}", name)
        return parameters
