"""Attacks on the live page and the race server."""

import collections
import contextlib
import os
import resource
import select
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.request

import zmq

from stkzoo.race import run_race
from stkzoo.race.remote import RemoteDriverGroup
from stkzoo.race.remote.protocol import ERROR, HELLO, VERSION, pack, unpack
from tests.support.remote_race import running_server, server_command

#: An incomplete HTTP request.
HALF_REQUEST = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: "
#: The first half of a ZeroMQ client's greeting (ZMTP 3.1, without security).
HALF_GREETING = b"\xff" + b"\0" * 8 + b"\x7f\x03\x01NULL"


def allow_descriptors(count):
    """Raises this program's limit on open descriptors; ends it if the hard limit is too low."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard not in (-1, resource.RLIM_INFINITY) and hard < count:
        raise SystemExit(f"the hard limit is {hard} descriptors, expected {count}: ulimit -Hn")
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, count), hard))


def limited(command, descriptors):
    """Returns a command that runs with a limit on open descriptors."""
    return ["sh", "-c", f'ulimit -n {descriptors} && exec "$@"', "sh", *command]


@contextlib.contextmanager
def race_with_page(*words, descriptors=1024, port=0):
    """Runs ``stkzoo race --web``; yields the process and the page's address."""
    command = [sys.executable, "-m", "stkzoo", "race", "--web", "--web-port", str(port), *words]
    process = subprocess.Popen(
        limited(command, descriptors),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        lines = []
        while "live page: " not in (line := process.stderr.readline()):
            lines.append(line)
            assert line, f"no page: {lines}"
        yield process, line.split("live page: ")[1].strip()
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def connect_all(address, count, data, hold):
    """Opens connections that send ``data`` and then nothing.

    Args:
        address: host and port.
        count: number of connections.
        data: what each connection sends.
        hold: list to which the sockets are appended.
    """
    for _ in range(count):
        one = socket.socket()
        one.setblocking(False)
        one.connect_ex(address)
        hold.append(one)
    waiting = {one.fileno(): one for one in hold}
    poller = select.poll()
    for number in waiting:
        poller.register(number, select.POLLOUT)
    deadline = time.monotonic() + 60
    while waiting and time.monotonic() < deadline:
        for number, _ in poller.poll(200):
            poller.unregister(number)
            with contextlib.suppress(OSError):
                waiting.pop(number).send(data)


def num_open(sockets):
    """Returns how many of these connections the other end has not closed."""
    return sum(map(_is_open, sockets))


def _is_open(one):
    try:
        one.setblocking(False)
        while one.recv(1 << 16):
            pass
    except BlockingIOError:
        return True
    except OSError:
        pass
    return False


def reset_at_once(address, count):
    """Opens ``count`` connections and resets each of them at once."""
    for _ in range(count):
        with contextlib.suppress(OSError), socket.socket() as one:
            one.settimeout(2)
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            one.connect(address)


def page_answers(url, timeout=5.0):
    """Returns the time until the page answers [s]; ``None`` if it does not answer."""
    begin = time.monotonic()
    try:
        with urllib.request.urlopen(url, timeout=timeout) as answer:
            answer.read()
    except OSError:
        return None
    return time.monotonic() - begin


def num_descriptors(pid):
    """Returns the number of open descriptors of a process."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def upgrade_request():
    """Returns a request that opens the page's WebSocket."""
    return (
        b"GET /live?version=1 HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
        b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )


def limited_server(*arguments, descriptors=1024, stderr=None):
    """Runs ``stkzoo race-server`` with few descriptors; yields the process and its address."""
    return running_server(limited(server_command(*arguments), descriptors), stderr)


class IdleClients:
    """Clients that greet a server and then send nothing.

    Args:
        address: address of the server.
        count: number of clients.
    """

    def __init__(self, address, count):
        self._context = zmq.Context(io_threads=1)
        self._context.set(zmq.MAX_SOCKETS, count + 100)
        self._clients = [self._context.socket(zmq.DEALER) for _ in range(count)]
        for client in self._clients:
            client.setsockopt(zmq.LINGER, 0)
            client.setsockopt(zmq.RECONNECT_IVL, 1000)
            client.connect(address)
            client.send_multipart([HELLO, pack(protocol=VERSION, stkzoo="0")])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        """Closes all clients."""
        self._context.destroy(0)

    def hear(self, seconds):
        """Returns a ``Counter`` of the kinds of received messages; errors count by their text."""
        heard = collections.Counter()
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for client in self._clients:
                while client.poll(0):
                    kind, body = client.recv_multipart()
                    heard[unpack(body)["text"] if kind == ERROR else kind] += 1
            time.sleep(0.05)
        return heard


def remote_race(address, steps=20):
    """Runs a race on a server; returns the errors of its agents."""
    with RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], track="lighthouse", seed=1, max_steps=steps)
    return [error for row in result.agents for error in row.errors]


def zmtp_socket(address, identity=b""):
    """Returns a plain socket after a handshake with a ZeroMQ server; it can send any bytes."""
    host, port = address.removeprefix("tcp://").rsplit(":", 1)
    one = socket.create_connection((host, int(port)), timeout=10)
    one.sendall(zmtp_greeting("DEALER", identity))
    heard = b""
    while b"READY" not in heard:  # messages before the end of the handshake are refused
        heard += one.recv(1 << 16) or b"READY"
    return one


def zmtp_greeting(kind, identity=b""):
    """Returns the bytes with which a ZeroMQ socket of a kind opens a connection."""
    mechanism = b"NULL".ljust(20, b"\0")
    properties = b"\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind.encode()
    if identity:
        properties += b"\x08Identity" + struct.pack(">I", len(identity)) + identity
    ready = b"\x05READY" + properties
    greeting = b"\xff" + b"\0" * 8 + b"\x7f\x03\x00" + mechanism + b"\0" * 32
    return greeting + bytes([4, len(ready)]) + ready


def zmtp_frame(data, *, more=False, command=False):
    """Returns a ZMTP frame."""
    return bytes([2 | more | 4 * command]) + struct.pack(">Q", len(data)) + data


@contextlib.contextmanager
def endless_server(*messages, most=512 << 20):
    """Runs a server that sends each client some messages, then one that does not end.

    Args:
        messages: messages before the endless one, each a list of frames.
        most: number of bytes after which the server only keeps the connection open.

    Yields:
        The server's address.
    """
    start = b""
    for *first, last in messages:
        start += b"".join(zmtp_frame(frame, more=True) for frame in first) + zmtp_frame(last)
    block = zmtp_frame(bytes(1 << 20), more=True)

    def serve(client):
        with client, contextlib.suppress(OSError):
            client.sendall(zmtp_greeting("ROUTER"))
            heard = b""
            while b"READY" not in heard:  # messages before the end of the handshake are refused
                heard += client.recv(1 << 16) or b"READY"
            client.sendall(start)
            for _ in range(most // len(block)):
                client.sendall(block)
                time.sleep(0.002)
            while client.recv(1 << 16):
                pass

    def accept():
        with contextlib.suppress(OSError):
            while True:
                threading.Thread(target=serve, args=listener.accept()[:1], daemon=True).start()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=accept, daemon=True).start()
        yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"
        listener.shutdown(socket.SHUT_RDWR)


#: A heartbeat; the other end answers it.
PING = zmtp_frame(b"\x04PING\0\0", command=True)


def send_until_closed(one, data, seconds=10.0):
    """Sends the same bytes repeatedly; returns whether the other end closed the connection."""
    one.settimeout(seconds)
    deadline = time.monotonic() + seconds
    try:
        while time.monotonic() < deadline:
            one.sendall(data)
    except TimeoutError:
        return False
    except OSError:
        return True
    return False
