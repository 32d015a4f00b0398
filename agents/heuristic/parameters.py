"""Every number that the heuristic driver goes by."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["DriverParameters"]


@dataclass(frozen=True, slots=True)
class DriverParameters:
    """How the heuristic driver drives.

    Attributes:
        step_size: game time between two calls [s].
        aim_distance: how far ahead to aim at standstill [m].
        aim_time: how much farther for each m/s [s].
        min_aim_distance: the aim is never drawn nearer than this [m].
        shortcut_margin: how far from the road's edge the way to the aim keeps [m];
            negative lets it cut the edge.
        wheel_base: distance between the axles that turns the aim into a steering angle [m].
        steer_gain: factor on the steering angle that would just reach the aim.
        brake_angle: brake when the aim is farther off than this [rad].
        brake_speed: but only above this speed [m/s].
        drift_start_speed: no drift starts below this speed [m/s].
        drift_min_turn: nor where the curve takes less than this share of full lock,
        drift_max_turn: nor where it takes more, on average over
        drift_look_time: this time ahead [s],
        drift_min_time: nor for a curve that lasts less than this [s].
        drift_min_steer: nor while steering less than this into the curve.
        drift_max_steer: nor more, for then the kart slides off.
        drift_stop_speed: a drift ends below this speed [m/s].
        drift_end_time: or when the curve ends within this time [s].
        drift_tight_steer: or when steering more than this would be needed,
        drift_counter_steer: or less than this (negative is out of the curve),
        drift_bonus_steer: or less than this once the drift has earned its boost.
        drift_max_time: a drift lasts no longer than this [s].
        drift_bonus_time: time of drifting that earns a boost [s].
        curve_curvature: a curve lasts while the line bends more than this [1/m].
        nitro_curvature: nitro is used where the line bends less than this [1/m] and
        nitro_steer: the wheel is turned less than this, and
        nitro_min_speed: the kart is at least so fast [m/s].
        straight_angle: on a straight the aim is less far off than this [rad].
        fire_every: calls between two shots.
        item_reach: items farther ahead than this are not looked at [m].
        item_min_ahead: nor nearer ones [m].
        item_swerve: nor those farther off the way than this share of their distance.
        item_edge: an item to collect lies at least this far from the road's edge [m].
        dodge_reach: a bad item nearer than this is dodged [m],
        dodge_width: if the way passes it by less than this [m].
        dodge_weight: metres of detour that a metre too near to a bad item is worth.
        stuck_speed: slower than this is standing still [m/s].
        stuck_time: after standing so long, back out [s].
        reverse_time: for so long [s].
        rescue_reverses: after backing out so often without getting away, call the rescue.
        free_time: driving so long means having got away [s].
    """

    step_size: float = 0.1
    aim_distance: float = 8.0
    aim_time: float = 0.55
    min_aim_distance: float = 8.0
    shortcut_margin: float = -2.0
    wheel_base: float = 1.3
    steer_gain: float = 2.5
    brake_angle: float = 0.9
    brake_speed: float = 8.0
    drift_start_speed: float = 13.0
    drift_min_turn: float = 0.2
    drift_max_turn: float = 0.8
    drift_look_time: float = 1.2
    drift_max_time: float = 9.0
    drift_min_time: float = 1.2
    drift_min_steer: float = 0.15
    drift_max_steer: float = 0.9
    drift_stop_speed: float = 11.0
    drift_end_time: float = 0.2
    drift_tight_steer: float = 1.3
    drift_counter_steer: float = -0.35
    drift_bonus_steer: float = -0.1
    drift_bonus_time: float = 1.1
    curve_curvature: float = 0.006
    nitro_curvature: float = 0.012
    nitro_steer: float = 0.5
    nitro_min_speed: float = 8.0
    straight_angle: float = 0.25
    fire_every: int = 10
    item_reach: float = 30.0
    item_min_ahead: float = 3.0
    item_swerve: float = 0.25
    item_edge: float = 1.6
    dodge_reach: float = 25.0
    dodge_width: float = 1.3
    dodge_weight: float = 8.0
    stuck_speed: float = 1.5
    stuck_time: float = 0.8
    reverse_time: float = 1.0
    rescue_reverses: int = 1
    free_time: float = 3.0
