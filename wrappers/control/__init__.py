"""Actions in physical units: speed or acceleration, and steering angle or steering speed.

:class:`LongitudinalAction` and :class:`SteerAction` convert the requested values to an acceleration
and a turning speed of the wheels; :class:`CarAction` converts both to the game's controls. All are
pure functions over arrays with any leading axes. :class:`ControlWrapper` applies them to one agent.
"""

from stkzoo.wrappers.control.car_action import (
    AcclAction,
    CarAction,
    LongitudinalAction,
    LongitudinalActionEnum,
    SpeedAction,
    SteerAction,
    SteerActionEnum,
    SteeringAngleAction,
    SteeringSpeedAction,
    from_single_to_multi_action_space,
)
from stkzoo.wrappers.control.kart import CarParameters
from stkzoo.wrappers.control.wrapper import ControlWrapper

__all__ = [
    "AcclAction",
    "CarAction",
    "CarParameters",
    "ControlWrapper",
    "LongitudinalAction",
    "LongitudinalActionEnum",
    "SpeedAction",
    "SteerAction",
    "SteerActionEnum",
    "SteeringAngleAction",
    "SteeringSpeedAction",
    "from_single_to_multi_action_space",
]
__dir__ = __all__.copy
