"""Attacks on the live page and the race server."""

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

from stkzoo.race import run_race
from stkzoo.race.remote import RemoteDriverGroup
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


def remote_race(address, steps=20):
    """Runs a race on a server; returns the errors of its agents."""
    with RemoteDriverGroup([address]) as group:
        result = run_race([*group.drivers, "ai"], track="lighthouse", seed=1, max_steps=steps)
    return [error for row in result.agents for error in row.errors]
