"""Sends the first byte of each reply at once and the rest 0.3 s later."""

import socket
import time

sendall = socket.socket.sendall


def slowly(connection, data):
    sendall(connection, data[:1])
    time.sleep(0.3)
    sendall(connection, data[1:])


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        socket.socket.sendall = slowly
        return action_space.sample()

    return actor
