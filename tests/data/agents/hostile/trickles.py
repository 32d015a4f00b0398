"""Sends the first byte of each reply at once and the rest 0.3 s later."""

import os
import time
from multiprocessing.connection import Connection


def slowly(connection, data):
    os.write(connection.fileno(), data[:1])
    time.sleep(0.3)
    os.write(connection.fileno(), data[1:])


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        Connection._send = slowly
        return action_space.sample()

    return actor
