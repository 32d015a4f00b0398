"""Every number that the heuristic driver goes by."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DriverParameters"]


@dataclass(frozen=True, slots=True)
class DriverParameters:
    """How the heuristic driver drives. Plans are weighed in metres of way.

    Attributes:
        wheel_base: turns the greatest steering angle into a curve [m].
        aim_distance: how far ahead to aim at standstill [m].
        aim_time: how much farther for each m/s [s].
        margin: how far from the road's edge to keep [m].
        lane_changes: plans may go over from one of so many lanes to another; 0 if to none.
        greatest_room: how far from the middle of the road to drive at most [m].
        over_cost: of a second that is spent a metre beyond that [m].
        late_time: so long after its end a plan goes straight on [s]; it should still be on
            the road then,
        late_cost: for each metre beyond costs so much [m].
        angle_cost: of ending at an angle of a radian to the road [m].
        drift_speed: no drift begins below this speed [m/s].
        brake_speed: nobody brakes below this one [m/s]: the brake then drives backwards.
        boost_worth: of the boost of a short drift [m].
        big_boost_worth: of the boost of a long one [m].
        boost_wait_cost: for each second until the boost begins [m].
        box_worth: of a bonus box [m],
        second_box_worth: when the kart has a power-up already [m].
        small_nitro_worth: of a small bottle of nitro [m].
        big_nitro_worth: of a big one [m].
        banana_cost: of a banana [m].
        gum_cost: of bubble gum [m].
        item_radius: a good item is hit that is passed as near as this [m].
        bad_item_radius: a bad one too [m].
        nitro_wait: time from one burst of nitro to the next [s].
        nitro_speed: nitro is used above this speed [m/s],
        nitro_turn: where less than this share of full lock is turned.
        danger: nitro and power-ups are for plans that cost less than this beyond the edge [m].
        straight_angle: power-ups are for where the road turns less than this [rad]
        straight_time: in the next time [s],
        straight_aim: and the kart is at less than this angle to it [rad].
        switch_reach: the switch is kept while items are nearer than this [m].
        fire_every: calls between two shots.
        crash_drop: who loses so much speed in a call has hit something [m/s], and
        caution_time: for this time [s] keeps
        caution_room: so near to the middle of the road [m].
        stuck_speed: slower than this is standing still [m/s].
        stuck_time: after standing so long, back out [s].
        crawl_speed: who is slower than this [m/s]
        crawl_time: for this time [s] is stuck too.
        reverse_time: for so long [s].
        rescue_reverses: after backing out so often without getting away, call the rescue.
        rescued_reverses: and so often more when the last rescue did not help.
        free_time: driving so long means having got away [s].
        lost_room: who is farther than this beyond the edge of the road [m]
        lost_time: for this time [s] calls the rescue.
        bump_cost: of running into a slower kart ahead, for each m/s of difference [m]; for
            learned drivers, who know how fast others are,
        bump_width: where its middle is nearer than this to the way [m].
    """

    wheel_base: float = 0.89
    aim_distance: float = 4.67
    aim_time: float = 0.31
    margin: float = 1.13
    lane_changes: int = 4
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
    fire_every: int = 3
    crash_drop: float = 6.0
    caution_time: float = 3.0
    caution_room: float = 1.76
    stuck_speed: float = 1.5
    stuck_time: float = 0.4
    crawl_speed: float = 6.0
    crawl_time: float = 2.5
    reverse_time: float = 1.0
    rescue_reverses: int = 0
    rescued_reverses: int = 1
    free_time: float = 6.0
    lost_room: float = 6.0
    lost_time: float = 1.0
    bump_cost: float = 1.0
    bump_width: float = 1.5
