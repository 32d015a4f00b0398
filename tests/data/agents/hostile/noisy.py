import os
import sys


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        os.write(1, os.urandom(100_000))
        os.write(2, b"\xff\x00" * 1000)
        sys.stdin.read()
        action = action_space.sample()
        action.update(brake=0, rescue=0)
        action["acceleration"][:] = 1
        return action

    return actor
