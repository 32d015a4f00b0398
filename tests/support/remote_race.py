"""Servers for tests of networked races, with real processes and sockets."""

from __future__ import annotations

import subprocess
import sys
import threading
from contextlib import contextmanager

import msgspec
import zmq

from stkzoo.drivers.messages import encode
from stkzoo.race.remote import RaceServer
from stkzoo.race.remote.protocol import VERSION, Act, Hello, Offer, Open, Welcome, read_request

#: An agent that drives straight ahead at full throttle.
GOOD = """\
env_name = "supertuxkart/simple-v0"
player_name = "{name}"

def get_actor(module_dir, observation_space, action_space):
    def act(state, observation):
        {act}
        return dict(action_space.sample(), acceleration=[1.0], steer=[0.0], brake=0, rescue=0)
    return act
"""


def write_agent(folder, name, act="pass"):
    """Writes an agent into a folder; ``act`` is a line that it executes in every step."""
    home = folder / name
    home.mkdir()
    (home / "pystk_actor.py").write_text(GOOD.format(name=name, act=act))
    return str(home)


def server_process(*arguments, address="127.0.0.1:*"):
    """Runs ``stkzoo race-server``; yields the process and its address."""
    return running_server(server_command(*arguments, address=address))


def server_command(*arguments, address="127.0.0.1:*"):
    """Returns the command line of a server."""
    return [sys.executable, "-m", "stkzoo", "race-server", "--address", address, *arguments]


@contextmanager
def running_server(command, stderr=None):
    """Runs a server by its command; yields its process and its address."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        line = process.stdout.readline()
        assert " at tcp://" in line, "the server did not start; its errors are above"
        yield process, line.split(" at ")[1].strip()
    finally:
        process.kill()
        process.wait()
        for stream in filter(None, (process.stdout, process.stderr)):
            stream.close()


@contextmanager
def server_thread(drivers, **options):
    """Runs a server in a thread of this program."""
    with RaceServer(drivers, "127.0.0.1:*", **options) as server:
        thread = threading.Thread(target=server.serve)
        thread.start()
        try:
            yield server
        finally:
            server.stop()
            thread.join()


def open_request(**changes):
    """Returns the fields of a request for an agent, which may be invalid, as a message."""
    fields = {"client": "c" * 16, "driver": 0, "agent": "kart_0", "extras": [], "seed": 1}
    fields |= {"type": "open", "action_timeout": 1.0, "start_timeout": 5.0}
    return msgspec.msgpack.encode({**fields, **changes})


@contextmanager
def raw_client(address):
    """Yields a socket that can send any message to a server."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVTIMEO, 10_000)
        socket.setsockopt(zmq.SNDTIMEO, 10_000)
        socket.connect(address)
        yield socket


class LyingServer:
    """A server that accepts all clients and sends false replies.

    Args:
        lie: returns the frames of the reply to a message that requests an agent or an action;
            each is a message of its own.
        welcome: the reply to a hello.
    """

    def __init__(self, lie, welcome=None):
        agents = [Offer("liar", "lies", [])]
        self._lie, self._end = lie, threading.Event()
        self._welcome = welcome or encode(Welcome(VERSION, "0", agents))
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.bind("tcp://127.0.0.1:*")
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        self._socket.close()
        self._context.term()

    def _serve(self):
        while not self._end.is_set():
            if not self._socket.poll(50):
                continue
            identity, *frames = self._socket.recv_multipart()
            for reply in self._replies(read_request(frames)):
                self._socket.send_multipart([identity, reply])

    def _replies(self, message):
        if isinstance(message, Hello):
            return [self._welcome]
        return self._lie(message) if isinstance(message, Open | Act) else []
