import os


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        print("goodbye, cruel race", flush=True)
        os._exit(1)

    return actor
