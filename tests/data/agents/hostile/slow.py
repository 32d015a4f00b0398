"""Takes 0.3 s for each decision."""

import time


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        time.sleep(0.3)
        return action_space.sample()

    return actor
