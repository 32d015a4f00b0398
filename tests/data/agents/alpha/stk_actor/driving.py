from dataclasses import dataclass

import numpy as np


@dataclass
class Memory:
    steps: int = 0
    slow: int = 0


def drive(state, observation):
    """Steers towards a point ahead. Positions are polar: distance, angle to the right, angle up."""
    state.steps += 1
    is_slow = state.steps > 60 and np.linalg.norm(observation["velocity"]) < 1.0
    state.slow = state.slow + 1 if is_slow else 0
    angle = observation["paths_end"][3][0]
    return {
        "acceleration": np.array([1.0], np.float32),
        "steer": np.array([np.clip(2.5 * angle, -1, 1)], np.float32),
        "brake": 0,
        "drift": 0,
        "fire": int(state.steps % 20 == 0),
        "nitro": 0,
        "rescue": int(state.slow > 20),
    }
