"""Pure pursuit by speed and steering angle: a short driver in physical units.

It aims at a point on the road ahead and drives as fast as the curve allows. It demonstrates actions
in physical units (``docs/reference/control.md``) and works with any of their four combinations; the
heuristic driver is faster.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from .driver import PursuitDriver, PursuitParameters, PursuitState

__all__ = [
    "PursuitDriver",
    "PursuitParameters",
    "PursuitState",
    "create_state",
    "env_name",
    "get_actor",
    "get_wrappers",
    "player_name",
]
__dir__ = __all__.copy

#: Id of the environment that the driver was made for; its wrapper adds physical units.
env_name = "supertuxkart/full-v0"

#: Display name.
player_name = "pursuit"

create_state = PursuitState


def get_wrappers() -> list[Any]:
    """Returns wrappers for actions of speed, steering angle and the rescue button."""
    from stkzoo.wrappers.control import ControlWrapper

    return [partial(ControlWrapper, buttons=("rescue",))]


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> PursuitDriver:
    """Returns the driver; it ignores the arguments.

    Args:
        module_dir: folder of the driver's module.
        observation_space: observation space of the agent.
        action_space: action space of the agent.
    """
    del module_dir, observation_space, action_space
    return PursuitDriver()
