"""Agents that attack their race, and the checks of such races."""

import os
import re
import textwrap
import threading
from dataclasses import dataclass
from pathlib import Path

from stkzoo.race import run_race
from tests.support.paths import AGENTS
from tests.support.processes import children_of


@dataclass(frozen=True)
class Adversary:
    """An agent that attacks at its first step.

    Attributes:
        act: statements that the actor executes.
        says: regular expression for the message of its failure.
        step: step at which the agent fails.
    """

    act: str
    says: str = "ZeroDivision"
    step: int = 0


FAIL = "; 1 / 0"
SLEEP = "; time.sleep(99)"
LATE = "took longer than"
INVALID = "sent an invalid message"

ADVERSARIES = {
    # processes and signals
    "kills everyone": Adversary("os.kill(-1, signal.SIGKILL)", "No such process"),
    "kills its parent": Adversary("os.kill(os.getppid(), signal.SIGKILL)" + SLEEP, ""),
    "stops its parent": Adversary("os.kill(os.getppid(), signal.SIGSTOP)" + SLEEP, ""),
    "stops itself": Adversary("os.kill(os.getpid(), signal.SIGSTOP)" + SLEEP, LATE),
    "leaves daemons": Adversary(
        "os.fork() or os.setsid() or os.fork() or os.execlp('sleep', MARK, '3600'); "
        "time.sleep(0.2)" + FAIL
    ),
    "forks": Adversary(
        "[os.fork() or time.sleep(99) for _ in range(200)]" + SLEEP, "processes|temporarily"
    ),
    "makes namespaces": Adversary(
        "[libc.syscall(n, 0x10000000, 0, 0, 0, 0) for n in (272, 56, 97, 220)]; "
        "[libc.syscall(n, 1, 0) for n in (425, 250, 219)]" + FAIL,
        "ZeroDivision|exited",
    ),
    "aborts": Adversary("os.abort()", "was ended by SIGABRT"),
    "never answers": Adversary("time.sleep(99)", LATE),
    # memory, files and output
    "shares memory": Adversary(
        "[take(mmap.mmap(-1, 200 << 20), 200) for _ in range(3)]" + SLEEP,
        "used more than 400 MB|not implemented",
    ),
    "hides memory": Adversary(
        "[hide(60) for _ in range(20)]" + SLEEP, "used more than 400 MB|not implemented"
    ),
    "fills page tables": Adversary("fill_tables(210 << 30)" + SLEEP, "used more than 400 MB"),
    "spreads memory": Adversary(
        "[os.fork() or (take(bytearray(150 << 20), 150), time.sleep(99)) for _ in range(4)]"
        + SLEEP,
        "used more than 400 MB",
    ),
    "fills its folders": Adversary("fill('/tmp'); fill('/dev/shm')" + FAIL, "No space"),
    "writes sparse files": Adversary("open('/tmp/x', 'wb').truncate(10 << 30)", "too large"),
    "makes many files": Adversary(
        "[open(f'/tmp/{n}', 'w').close() or os.link(f'/tmp/{n}', f'/tmp/l{n}') "
        "for n in range(5000)]" + FAIL
    ),
    "opens many files": Adversary(
        "[kept.append((os.eventfd(0), os.dup(0))) for _ in range(5000)]", "Too many open"
    ),
    "opens many pipes": Adversary(
        "[os.fork() or (kept.extend(os.pipe() for _ in range(100)), time.sleep(99)) "
        "for _ in range(4)]" + SLEEP,
        "opened more than 256 pipes",
    ),
    "starts many threads": Adversary(
        "threading.stack_size(1 << 16); "
        "[threading.Thread(target=time.sleep, args=(99,)).start() for _ in range(600)]" + SLEEP,
        "more than 512 threads|start new thread",
    ),
    "sends many descriptors": Adversary("[send_files() for _ in range(99)]", "Too many"),
    "sends its sockets with descriptors": Adversary("nest_files(99)", "Too many"),
    "prints": Adversary("[os.write(1, bytes(1 << 16)) for _ in range(500)]" + FAIL),
    # Python
    "recurses": Adversary(
        "sys.setrecursionlimit(10**9); recurse()",
        "SIGSEGV|Recursion|exited|Memory|took longer than",
    ),
    "leaves finalizers": Adversary(
        "atexit.register(time.sleep, 60); kept.append(Immortal())" + FAIL
    ),
    "raises KeyboardInterrupt": Adversary("raise KeyboardInterrupt", "exited|SIGINT"),
    "raises an error without end": Adversary("raise Endless", LATE),
    "returns an endless array": Adversary("return dict.fromkeys(action_space, Array())", LATE),
    # the connection
    "closes everything": Adversary("os.closerange(0, 4096)", "closed its connection|exited"),
    "is its own echo": Adversary(
        "os.dup2(fd(), 0); os.dup2(fd(), 1); os.execlp('cat', 'cat')", LATE
    ),
    "forges bytes": Adversary("raw(b'\\0\\0\\0\\x05\\xc1\\xc1\\xc1\\xc1\\xc1')" + SLEEP, INVALID),
    "announces too much": Adversary("raw(b'\\xf0\\xff\\xff\\xff')" + SLEEP, "a message of"),
    "nests its reply": Adversary("raw(frame(b'\\x91' * 65536))" + SLEEP, INVALID),
    "trickles": Adversary("raw(b'\\0\\0\\xf0\\0'); [trickle() for _ in range(10**6)]", LATE),
    "sends a long error": Adversary(
        "channel().send(Failed('error', 'x' * 10**5, '', True))" + SLEEP, "a message of"
    ),
    "answers twice": Adversary("twice()", "expected", step=2),
    "stalls at its second step": Adversary("later(time.sleep, 99)", LATE, step=1),
}

_PRELUDE = """
import array, atexit, ctypes, gc, mmap, os, resource, signal, socket, struct, sys, threading, time
from stkzoo.drivers.messages import Failed
from stkzoo.drivers.isolated import Channel

MARK = {mark!r}
libc = ctypes.CDLL(None, use_errno=True)
kept = []

def take(block, size):
    for page in range(0, size << 20, 4096):
        block[page] = 1
    kept.append(block)

def hide(size):
    place = os.memfd_create("x")
    kept.append(place)
    for _ in range(size):
        os.write(place, bytes(1 << 20))

def send_files(*files):
    pair = socket.socketpair()
    kept.append(pair)
    sent = array.array("i", files or [1] * 253)
    pair[0].sendmsg([b"x"], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, sent)])
    return pair

def nest_files(count):
    for _ in range(count):
        one, other = send_files()
        send_files(one.fileno(), other.fileno())
        one.close()
        other.close()

def fill_tables(size):
    flags = mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | 0x4000
    block = mmap.mmap(-1, size, flags=flags, prot=mmap.PROT_READ)
    block.madvise(15)  # no huge pages
    for page in range(0, size, 2 << 20):
        block[page]
    kept.append(block)

def fill(folder):
    while True:
        path = os.path.join(folder, MARK + str(len(kept)))
        kept.append(path)
        with open(path, "wb") as file:
            file.write(bytes(1 << 20))

def spin():
    while True:
        pass

def recurse():
    return [recurse()]

class Immortal:
    def __del__(self):
        kept.append(self)
        time.sleep(60)

class Endless(Exception):
    def __str__(self):
        while True:
            pass

class Array:
    def __array__(self, *_, **__):
        spin()

def channel():
    return next(item for item in gc.get_objects() if isinstance(item, Channel))

def fd():
    return channel()._connection.fileno()

def raw(data):
    channel()._connection._send(data)

def frame(data):
    return struct.pack("!I", len(data)) + data

def trickle():
    raw(b"x")
    time.sleep(0.001)

def twice():
    send = Channel.send
    Channel.send = lambda self, message: (send(self, message), send(self, message))

def later(function, *arguments):
    receive = Channel.receive
    Channel.receive = lambda self: (receive(self), function(*arguments))
"""
_ACTOR = """
def get_actor(module_dir, observation_space, action_space):
    calls = []
    def actor(state, observation):
        calls.append(1)
        if len(calls) == 1:
            {act}
        return action_space.sample()
    return actor
"""
_QUITTER = """
def get_actor(module_dir, observation_space, action_space):
    calls = []
    def actor(state, observation):
        if len(calls) == {step}:
            raise RuntimeError
        calls.append(1)
        return action_space.sample()
    return actor
"""


def write_adversary(folder, name, mark):
    """Writes an adversary and returns it as a driver.

    Args:
        folder: folder for all agents.
        name: name in :data:`ADVERSARIES`.
        mark: text that the names of its files and programs contain.
    """
    code = _PRELUDE.format(mark=mark) + _ACTOR.format(act=ADVERSARIES[name].act)
    return _write(folder, name, code)


def write_quitter(folder, name):
    """Writes an agent that does nothing but fail at the same step as an adversary."""
    return _write(folder, f"{name} quietly", _QUITTER.format(step=ADVERSARIES[name].step))


def _write(folder, name, code):
    place = folder / name.replace(" ", "_")
    place.mkdir(exist_ok=True)
    (place / "pystk_actor.py").write_text(textwrap.dedent(code))
    return f"{place}@:{name}"


#: Attacks of an agent that is behind.
VOIDS = {
    "kills": "os.kill(-1, signal.SIGKILL); os.kill(os.getppid(), signal.SIGKILL)",
    "stops": "os.kill(os.getppid(), signal.SIGSTOP); os.kill(os.getpid(), signal.SIGSTOP)",
    "floods": "[os.write(1, bytes(1 << 16)) for _ in range(500)]; raw(frame(bytes(1 << 20)))",
    "bombs": "[os.fork() for _ in range(12)]; time.sleep(99)",
}
_SORE_LOSER = """
import random

def get_actor(module_dir, observation_space, action_space):
    attack = random.choice({attacks!r})
    steps = []
    def actor(state, observation):
        steps.append(1)
        rivals = [place for place in observation["karts_position"] if abs(place).max() > 0]
        if len(steps) > 20 and any(place[2] > 0 for place in rivals):
            exec(attack, globals())
        return dict.fromkeys(action_space, 0) | {{"acceleration": [0.9], "steer": [0.0]}}
    return actor
"""


def write_sore_loser(folder, mark):
    """Writes an agent that attacks its race in a random way when it is behind."""
    code = _PRELUDE.format(mark=mark) + _SORE_LOSER.format(attacks=[*VOIDS.values()])
    return _write(folder, "sore loser", code)


def race_with(*drivers):
    """Runs a short race of two ordinary drivers and others; returns its result."""
    return run_race(
        [str(AGENTS / "plain"), "heuristic", *drivers],
        track="lighthouse",
        seed=1,
        sandbox="on",
        action_timeout=5.0,
        agent_memory=400,
        max_steps=60,
    )


def problems_of(result, undisturbed):
    """Returns descriptions of what went wrong in a race with adversaries.

    Args:
        result: result of the race.
        undisturbed: result of the same race with agents that only fail at the same steps.
    """
    ordinary = [
        [row for row in race.agents if row.driver in ("Plain", "heuristic")]
        for race in (result, undisturbed)
    ]
    problems = [] if ordinary[0] == ordinary[1] else ["the results of the other drivers differ"]
    for row in result.agents:
        if (adversary := ADVERSARIES.get(row.driver)) is None:
            continue
        failure = row.errors[0] if row.errors else None
        if failure is None or row.status != "retired":
            problems.append(f"{row.driver!r} was not retired")
        elif failure.step != adversary.step or not re.search(adversary.says, failure.message):
            failed = f"failed at step {failure.step}: {failure.message[:100]}"
            problems.append(f"{row.driver!r} {failed}")
    return problems


def left_behind(mark):
    """Counts what this program and its agents currently have, by kind."""
    commands = [_text(folder / "cmdline") for folder in Path("/proc").glob("[0-9]*")]
    names = [name for folder in ("/tmp", "/dev/shm") for name in os.listdir(folder)]
    return {
        "processes": len(children_of(os.getpid())) + sum(mark in text for text in commands),
        "files": sum(mark in name or name.startswith("stkzoo-agent") for name in names),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
    }


def _text(file):
    try:
        return file.read_text(errors="replace")
    except OSError:
        return ""
