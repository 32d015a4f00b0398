"""Thinks between its decisions, and fails if it could not."""

import threading
import time

thoughts = []


def think():
    while True:
        thoughts.append(1)
        time.sleep(0.01)


def get_actor(module_dir, observation_space, action_space):
    known = []

    def actor(state, observation):
        assert not known or len(thoughts) > known[-1], "no time to think"
        action = action_space.sample()
        known.append(len(thoughts))
        return action

    threading.Thread(target=think, daemon=True).start()
    return actor
