"""Sends its answer to the next request together with the current one."""

import os
from multiprocessing.connection import Connection


def twice(connection, data):
    os.write(connection.fileno(), 2 * data)


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        Connection._send = twice
        return action_space.sample()

    return actor
