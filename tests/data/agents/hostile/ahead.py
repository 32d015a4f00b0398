"""Sends its answer to the next request together with the current one."""

from stkzoo.drivers.codec import encode
from stkzoo.drivers.process import Channel
from stkzoo.drivers.replies import LENGTH

send = Channel.send


def send_ahead(channel, message):
    if "number" not in message:
        send(channel, message)
        return
    answers = [encode({**message, "number": message["number"] + more}) for more in (0, 1)]
    channel._connection.sendall(b"".join(LENGTH.pack(len(data)) + data for data in answers))


Channel.send = send_ahead


def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
