"""Actions in physical units: speed or acceleration, steering angle or steering speed.

The parts are pure functions over arrays with any leading axes: :class:`LongitudinalAction`
and :class:`SteerAction` turn what is asked for into an acceleration and a wheel angle,
:class:`Pedals` and :class:`CarAction` these into what the game takes. :class:`ControlWrapper`
puts them around one agent, and :class:`ControlView` makes a view of that.
"""

from stkzoo.wrappers.control.car_action import CarAction, from_single_to_multi_action_space
from stkzoo.wrappers.control.kart import CarParameters, Pedals
from stkzoo.wrappers.control.kinds import (
    AcclAction,
    LongitudinalAction,
    LongitudinalActionEnum,
    SpeedAction,
    SteerAction,
    SteerActionEnum,
    SteeringAngleAction,
    SteeringSpeedAction,
)
from stkzoo.wrappers.control.wrapper import ControlView, ControlWrapper

__all__ = [
    "AcclAction",
    "CarAction",
    "CarParameters",
    "ControlView",
    "ControlWrapper",
    "LongitudinalAction",
    "LongitudinalActionEnum",
    "Pedals",
    "SpeedAction",
    "SteerAction",
    "SteerActionEnum",
    "SteeringAngleAction",
    "SteeringSpeedAction",
    "from_single_to_multi_action_space",
]
