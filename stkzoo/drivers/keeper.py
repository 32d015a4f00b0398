"""The keeper of an agent: starts its process, watches it, and ends all that it started.

A program of its own (Linux), outside the agent's sandbox; it imports nothing of stkzoo. The kernel
hands it every process whose parent has ended, so that a process that left the agent's session is
still found. Its standard input is a socket to the race: when the race closes it or ends, so does
everything of the agent. Before that it writes one line there if it ended the agent itself.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence

#: Time between two looks at the agent's processes [ms].
_INTERVAL = 100
#: Most processes of one agent.
_MAX_PROCESSES = 128
_MAX_CHILDREN_TEXT = 2048
#: Time to measure the memory that processes share [s]; it is waited for so often.
_MEASURE_TIMEOUT, _MEASURE_TRIES = 0.05, 10
_PR_SET_PDEATHSIG, _PR_SET_DUMPABLE, _PR_SET_CHILD_SUBREAPER = 1, 4, 36


def main(race: int, connection: int, memory: int, cores: list[int], command: list[str]) -> int:
    """Runs until the agent or the race has ended.

    Args:
        race: process id of the race.
        connection: descriptor of the agent's socket, for the agent alone.
        memory: memory of all processes of the agent together [bytes]; 0 for no limit.
        cores: those that the agent runs on; empty for all.
        command: starts the agent.

    Returns:
        The exit code of the agent; 128 and the signal's number if a signal ended it.
    """
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    _prctl(_PR_SET_DUMPABLE, 0)  # other agents cannot take over its descriptors
    with contextlib.suppress(OSError):  # root has no limit of processes, which starve others
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    woken, wake = os.pipe()
    os.set_blocking(wake, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    agent = _start(command, cores)
    os.close(connection)
    poller = select.poll()
    for descriptor in (0, woken):
        poller.register(descriptor, select.POLLIN)
    status = reason = None
    while status is None and not reason and os.getppid() == race:
        events = dict(poller.poll(_INTERVAL))
        if woken in events:
            os.read(woken, 4096)
        if 0 in events:
            break
        status = _reap(agent)
        reason = _excess(memory)
    if reason:
        with contextlib.suppress(OSError):
            os.write(0, reason.encode())
    _end_all()
    return 1 if status is None else status if status >= 0 else 128 - status


def _start(command: list[str], cores: list[int]) -> int:
    keeper = os.getpid()
    agent = os.fork()
    if agent:
        return agent
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != keeper:
        os._exit(1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    if cores:
        os.sched_setaffinity(0, cores)
    os.setsid()  # a signal to its own group does not reach the keeper
    with contextlib.suppress(OSError):
        os.execv(command[0], command)  # noqa: S606 - the program that it is for
    os._exit(127)


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _reap(agent: int) -> int | None:
    """Reaps processes that have ended; the exit code of the agent's if it is among them."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            if ended[0] == agent:
                return os.waitstatus_to_exitcode(ended[1])
    return None


def _end_all() -> None:
    """Ends all processes of the agent; an orphan of one of them is a child from then on."""
    with contextlib.suppress(ChildProcessError):
        while True:
            for child in _children(os.getpid()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            os.waitpid(-1, 0)


def _excess(memory: int) -> str:
    """What the agent's processes have too much of; empty if nothing."""
    found = _processes()
    if len(found) > _MAX_PROCESSES:
        return f"started more than {_MAX_PROCESSES} processes"
    if memory and _resident(found) > memory < _in_time(lambda: _shares(found), memory + 1):
        return f"used more than {memory >> 20} MB with all its processes"
    return ""


def _processes() -> list[int]:
    """The agent's processes, not many more than are allowed."""
    return [*itertools.islice(descendants(os.getpid()), _MAX_PROCESSES + 1)]


def _in_time(measure: Callable[[], int], otherwise: int) -> int:
    """A measurement, or another number if a process delays it by keeping its memory locked."""
    measured: list[int] = []
    reader = threading.Thread(target=lambda: measured.append(measure()), daemon=True)
    reader.start()
    for _ in range(_MEASURE_TRIES):
        reader.join(_MEASURE_TIMEOUT)
        if measured or len(_processes()) > _MAX_PROCESSES:
            break
    return measured[0] if measured else otherwise


def _resident(processes: Sequence[int]) -> int:
    """Memory of some processes [bytes]; what they share counts more than once."""
    own = sum(memory_of(process, "status", ("RssAnon:",)) for process in processes)
    shared = sum(memory_of(process, "status", ("RssShmem:",)) for process in processes)
    return own + max(shared, _files_in_memory(processes))


def _shares(processes: Sequence[int]) -> int:
    """The same, where what is shared counts once; the system may hide it."""
    own, shared = (
        sum(memory_of(process, "smaps_rollup", (name,)) for process in processes)
        for name in ("Pss_Anon:", "Pss_Shmem:")
    )
    return own + max(shared, _files_in_memory(processes)) if own else _resident(processes)


def _files_in_memory(processes: Sequence[int]) -> int:
    """Size of open files without a name, which need not be mapped [bytes]."""
    sizes = {}
    for process in processes:
        with contextlib.suppress(OSError):
            for entry in os.scandir(f"/proc/{process}/fd"):
                with contextlib.suppress(OSError):
                    if os.readlink(entry.path).startswith("/memfd:"):
                        status = os.stat(entry.path)
                        sizes[status.st_ino] = 512 * status.st_blocks
    return sum(sizes.values())


def descendants(process: int) -> Iterator[int]:
    """The processes that a process has started, and those that they have started."""
    for child in _children(process):
        yield child
        yield from descendants(child)


def _children(process: int) -> list[int]:
    """The first children of each of its threads; all would take long for thousands."""
    found: list[int] = []
    with contextlib.suppress(OSError):
        for thread in os.listdir(f"/proc/{process}/task"):
            with open(f"/proc/{process}/task/{thread}/children", "rb", 0) as file:
                found += map(int, file.read(_MAX_CHILDREN_TEXT).split(b" ")[:-1])
    return found


def memory_of(process: int, file: str, names: tuple[str, ...]) -> int:
    """The sum of some lines of ``/proc/PROCESS/FILE`` [bytes]; 0 if it cannot be read."""
    total = 0
    with contextlib.suppress(OSError), open(f"/proc/{process}/{file}") as lines:
        for line in lines:
            if line.startswith(names):
                total += int(line.split()[1]) << 10
    return total


if __name__ == "__main__":
    race_, connection_, memory_, cores_, *command_ = sys.argv[1:]
    allowed = [*map(int, filter(None, cores_.split(",")))]
    sys.exit(main(int(race_), int(connection_), int(memory_), allowed, command_))
