"""A policy with weights in a separate file."""

import numpy as np

from .policy import Policy

env_name = "supertuxkart/flattened_continuous_actions-v0"
player_name = "Weights"


def get_actor(module_dir, observation_space, action_space):
    return Policy(np.loadtxt(module_dir / "weights.txt"), observation_space, action_space)
