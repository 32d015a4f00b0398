"""Sends its own error reports with millions of characters, and has a name of the same length."""

import os
import socket
import stat
import struct

import msgspec

LONG = "y" * 2_000_000
REPORT = {"type": "failed", "kind": "error", "text": LONG, "trace": LONG + "\x1b[2J"}
BOMB = msgspec.msgpack.encode(REPORT)
player_name = LONG


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
