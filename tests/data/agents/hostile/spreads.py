"""Allocates memory in many processes, each below the limit."""

import os
import time

import numpy as np


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        if not os.fork():
            kept = np.ones(200 << 20, np.uint8)
            time.sleep(3600)
            kept.fill(0)
        time.sleep(0.3)
        return action_space.sample()

    return actor
