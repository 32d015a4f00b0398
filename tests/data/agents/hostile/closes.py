import os


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        os.closerange(0, 1024)

    return actor
