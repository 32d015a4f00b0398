"""Sends invalid bytes to every open socket."""

import os
import socket
import stat


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        for number in range(3, 64):
            try:
                is_socket = stat.S_ISSOCK(os.fstat(number).st_mode)
            except OSError:
                continue
            if is_socket:
                with socket.socket(fileno=os.dup(number)) as connection:
                    connection.sendall(b"\xff\xff\xff\xff" + b"\xc1" * 5000)

    return actor
