"""A driver that rams the nearest kart, to test the measure of conduct.

It is an agent of one file: ``stkzoo race benchmarks/rammer.py heuristic``. It chases the nearest
kart within 40 m that is not far behind, at full throttle and with nitro. Without a victim, it
drives like the heuristic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from stkzoo import Phase
from stkzoo.agents import heuristic
from stkzoo.agents.planning.driver import PlanDriver

env_name = "supertuxkart/full-v0"
player_name = "rammer"

#: Maximum distance of a victim, and maximum distance behind the rammer [m].
_REACH, _BEHIND = 40.0, 3.0

create_state = heuristic.create_state


def drive(planner: PlanDriver, observation: Mapping[str, Any]) -> dict[str, Any]:
    """Returns an action toward the victim; without a victim, the action of the heuristic."""
    action = planner.drive(observation)
    victim = _nearest(observation)
    is_stuck = action["rescue"] or action["brake"]  # the heuristic frees the kart
    if victim is None or is_stuck or observation["phase"] < Phase.GO_PHASE:
        return action
    right, _, forward = victim
    steer = max(-1.0, min(1.0, 2.5 * math.atan2(right, forward)))
    return {
        "acceleration": np.ones(1, np.float32),
        "steer": np.array([steer], np.float32),
        **dict.fromkeys(("brake", "drift", "fire", "rescue"), 0),
        "nitro": 1,
    }


def _nearest(observation: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """Returns the position of the nearest kart that it can chase, in its own frame [m]."""
    near = [tuple(map(float, kart)) for kart in observation["karts_position"]]
    near = [kart for kart in near if math.hypot(*kart) < _REACH and kart[2] > -_BEHIND]
    return min(near, key=lambda kart: math.hypot(*kart), default=None)  # type: ignore[return-value]


def get_actor(
    module_dir: object, observation_space: Any, action_space: Any
) -> Callable[[PlanDriver, Mapping[str, Any]], dict[str, Any]]:
    """Returns the driver; it ignores the arguments."""
    del module_dir, observation_space, action_space
    return drive
