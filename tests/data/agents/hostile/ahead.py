"""Sends its answer to the next request together with the current one."""

from stkzoo.drivers.isolated import Channel
from stkzoo.drivers.messages import Decided, encode

send = Channel.send


def send_ahead(channel, message):
    if not isinstance(message, Decided):
        send(channel, message)
        return
    data = encode(message)
    for _ in range(2):
        channel._connection.send_bytes(data)


Channel.send = send_ahead


def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
