"""Sends a word outside its task's vocabulary, bypassing the checks in its own process."""

import os
import socket
import stat

from stkzoo.drivers.messages import Action, Decided, encode
from stkzoo.drivers.replies import LENGTH

env_name = "stkzoo-suite/talk-2v2-v1"

BUTTONS = dict.fromkeys(("brake", "drift", "fire", "nitro", "rescue"), 0)
REPLY = encode(Decided(Action(acceleration=0.5, steer=0.5, **BUTTONS, message=200), False))


def get_actor(module_dir, observation_space, action_space):
    def actor(state, observation):
        for number in range(3, 64):
            try:
                is_socket = stat.S_ISSOCK(os.fstat(number).st_mode)
            except OSError:
                continue
            if is_socket:
                with socket.socket(fileno=os.dup(number)) as connection:
                    connection.sendall(LENGTH.pack(len(REPLY)) + REPLY)

    return actor
