"""Attacks on what listens: the live page and the race-server."""

import contextlib
import os
import resource
import select
import socket
import struct
import subprocess
import sys
import time
import urllib.request

#: A request that never ends.
HALF_REQUEST = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: "
#: What a ZeroMQ client says first (ZMTP 3.1, without security), up to the middle of it.
HALF_GREETING = b"\xff" + b"\0" * 8 + b"\x7f\x03\x01NULL"


def allow_descriptors(count):
    """Raises this program's own limit of descriptors; raises an error if it may not."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard not in (-1, resource.RLIM_INFINITY) and hard < count:
        raise SystemExit(f"the hard limit is {hard} descriptors, expected {count}: ulimit -Hn")
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, count), hard))


def limited(command, descriptors):
    """A command that runs with so many descriptors at most."""
    return ["sh", "-c", f'ulimit -n {descriptors} && exec "$@"', "sh", *command]


@contextlib.contextmanager
def race_with_page(*words, descriptors=1024, port=0):
    """``stkzoo race --web`` as a process; gives the process and the page's address."""
    command = [sys.executable, "-m", "stkzoo", "race", "--web", "--web-port", str(port), *words]
    process = subprocess.Popen(limited(command, descriptors), stderr=subprocess.PIPE, text=True)
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


def connect_all(address, count, data=b"", hold=None):
    """Opens so many connections that send ``data`` and then nothing.

    Args:
        address: host and port.
        count: how many.
        data: what each one sends.
        hold: a list that gets the sockets; a connection that is refused is not in it.
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
    """How many of these connections the other end has not closed."""
    return sum(map(_is_open, sockets))


def _is_open(one):
    try:
        one.setblocking(False)
        return bool(one.recv(1, socket.MSG_PEEK))
    except BlockingIOError:
        return True
    except OSError:
        return False


def reset_at_once(address, count):
    """Connects so many times, and resets each connection at once."""
    for _ in range(count):
        with contextlib.suppress(OSError), socket.socket() as one:
            one.settimeout(2)
            one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            one.connect(address)


def page_answers(url, timeout=5.0):
    """Seconds until the page answers; ``None`` if it does not."""
    begin = time.monotonic()
    try:
        with urllib.request.urlopen(url, timeout=timeout) as answer:
            answer.read()
    except OSError:
        return None
    return time.monotonic() - begin


def num_descriptors(pid):
    """Open descriptors of a process."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def upgrade_request():
    """A request that opens the page's WebSocket."""
    return (
        b"GET /live?version=1 HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n"
        b"Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
