"""Pure pursuit by speed and steering angle: a short driver in physical units.

It aims at a point of the road ahead and drives as fast as the curve allows. It shows how to
use actions in physical units (``docs/reference/control.md``) and races through any of the four
combinations; the heuristic driver is the faster one.
"""

from __future__ import annotations

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

#: The environment that the driver was made for; its wrapper makes the actions physical.
env_name = "supertuxkart/full-v0"

#: The name to show.
player_name = "pursuit"

create_state = PursuitState


def get_wrappers() -> list[Any]:
    """Speed and steering angle in place of the game's own actions, and the bird's button."""
    from stkzoo.wrappers.control import ControlView

    return [ControlView(observe="full", buttons=("rescue",))]


def get_actor(module_dir: object, observation_space: Any, action_space: Any) -> PursuitDriver:
    """The driver; it needs none of the arguments, which every driver is given.

    Args:
        module_dir: folder of the driver's module, where others keep their weights.
        observation_space: the agent's observation space.
        action_space: the agent's action space.
    """
    del module_dir, observation_space, action_space
    return PursuitDriver()
