import numpy as np


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        return np.ones(10 << 30, np.uint8)

    return actor
