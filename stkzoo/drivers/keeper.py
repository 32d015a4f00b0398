"""The keeper: starts an agent's process, monitors it, and kills all of its descendants.

The keeper is a separate program for Linux. It runs outside the agent's sandbox and does not import
stkzoo. It is a subreaper: the kernel makes it the parent of orphaned descendants, so it also finds
processes that have left the agent's session. Its standard input is a socket to the race. When the
race closes this socket or ends, the keeper kills all of the agent's processes. If the agent exceeds
a limit, the keeper writes the reason to the socket before it kills them.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import select
import signal
import sys
from collections.abc import Iterable, Iterator, Sequence

#: Interval between two checks of the agent's processes [s].
_INTERVAL = 0.1
#: Maximum number of processes of one agent, and of their threads together.
_MAX_PROCESSES, _MAX_THREADS = 128, 512
_MAX_CHILDREN_TEXT = 2048
#: Maximum number of open files of all processes of one agent together; a check of them takes 40 ms.
_MAX_FILES = 8192
#: Maximum number of pipes among them. Linux counts their pages per user, and shrinks new pipes of
#: the user above 1,024 pipes.
_MAX_PIPES = 256
_PR_SET_PDEATHSIG, _PR_SET_DUMPABLE, _PR_SET_CHILD_SUBREAPER = 1, 4, 36


def main(race: int, connection: int, memory: int, cores: list[int], command: list[str]) -> int:
    """Runs until the agent or the race has ended.

    Args:
        race: process id of the race.
        connection: file descriptor of the agent's socket. The keeper closes its own copy.
        memory: memory limit of all processes of the agent together [bytes]; 0 for no limit.
        cores: processor cores for the agent and its keeper; empty for all.
        command: command that starts the agent.

    Returns:
        The agent's exit code; 128 plus the signal number if a signal ended the agent; 1 if the
            keeper ended it.
    """
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    _prctl(_PR_SET_DUMPABLE, 0)  # so that other agents cannot take its file descriptors
    with contextlib.suppress(OSError):  # root's agents have no process limit and could starve it
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # if it is ignored, no exit code is kept
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGCHLD})
    if cores:  # its checks must not slow down the race or other agents
        os.sched_setaffinity(0, cores)
    agent = _start(command)
    os.close(connection)
    status = reason = None
    try:
        while status is None and not reason and os.getppid() == race:
            signal.sigtimedwait({signal.SIGCHLD}, _INTERVAL)
            if select.select([0], [], [], 0)[0]:  # the race has closed the socket
                break
            status = _reap(agent)
            reason = _excess(memory)
        if reason:
            with contextlib.suppress(OSError):
                os.write(0, reason.encode())
    finally:  # an agent can use up the user's processes or memory, so that a check fails
        _end_all()
    return 1 if status is None else status if status >= 0 else 128 - status


def _start(command: list[str]) -> int:
    keeper = os.getpid()
    agent = os.fork()
    if agent:
        return agent
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != keeper:
        os._exit(1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGCHLD})
    os.setsid()  # so that an agent's signal to its own process group does not reach the keeper
    with contextlib.suppress(OSError):
        os.execv(command[0], command)  # noqa: S606 - our own command
    os._exit(127)


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _reap(agent: int) -> int | None:
    """Reaps ended processes; returns the agent's exit code if the agent is among them."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            if ended[0] == agent:
                return os.waitstatus_to_exitcode(ended[1])
    return None


def _end_all() -> None:
    """Kills all processes of the agent, including those that become children as orphans."""
    with contextlib.suppress(ChildProcessError):
        while True:
            for child in _children(os.getpid()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            os.waitpid(-1, 0)


def _excess(memory: int) -> str:
    """Returns which limit the agent's processes exceed, or an empty string."""
    processes = [*itertools.islice(descendants(os.getpid()), _MAX_PROCESSES + 1)]
    if len(processes) > _MAX_PROCESSES:
        return f"started more than {_MAX_PROCESSES} processes"
    if sum(map(_threads, processes)) > _MAX_THREADS:  # root has no process limit
        return f"started more than {_MAX_THREADS} threads with all its processes"
    files = [*itertools.islice(_open_files(processes), _MAX_FILES + 1)]
    if len(files) > _MAX_FILES:
        return f"opened more than {_MAX_FILES} files with all its processes"
    links = {path: _link(path) for path in files}
    if len({link for link in links.values() if link.startswith("pipe:")}) > _MAX_PIPES:
        return f"opened more than {_MAX_PIPES} pipes with all its processes"
    if not memory:
        return ""
    in_files = _files_in_memory(path for path, link in links.items() if link.startswith("/memfd:"))
    private = sum(memory_of(process, ("RssAnon:", "VmPTE:")) for process in processes)
    shared = sum(memory_of(process, ("RssShmem:",)) for process in processes)
    is_excess = private + max(shared, in_files) > memory
    return f"used more than {memory >> 20} MB with all its processes" if is_excess else ""


def _open_files(processes: Sequence[int]) -> Iterator[str]:
    """Yields the path of each file descriptor of processes."""
    for process in processes:
        with contextlib.suppress(OSError), os.scandir(f"/proc/{process}/fd") as entries:
            yield from (entry.path for entry in entries)


def _link(path: str) -> str:
    """Returns what a link names; empty if it no longer exists."""
    with contextlib.suppress(OSError):
        return os.readlink(path)
    return ""


def _files_in_memory(paths: Iterable[str]) -> int:
    """Returns the size of open anonymous files (memfd), which may not be mapped [bytes]."""
    sizes = {}
    for path in paths:
        with contextlib.suppress(OSError):
            status = os.stat(path)
            sizes[status.st_ino] = 512 * status.st_blocks
    return sum(sizes.values())


def _threads(process: int) -> int:
    with contextlib.suppress(OSError):
        return os.stat(f"/proc/{process}/task").st_nlink - 2
    return 0


def descendants(process: int) -> Iterator[int]:
    """Yields the ids of a process's children, and recursively of their children."""
    for child in _children(process):
        yield child
        yield from descendants(child)


def _children(process: int) -> list[int]:
    """Returns the first children of each thread; reading thousands would take too long."""
    children: list[int] = []
    with contextlib.suppress(OSError):
        for thread in os.listdir(f"/proc/{process}/task"):
            with open(f"/proc/{process}/task/{thread}/children", "rb", 0) as file:
                children += map(int, file.read(_MAX_CHILDREN_TEXT).split(b" ")[:-1])
    return children


def memory_of(process: int, names: tuple[str, ...]) -> int:
    """Returns the sum of the named lines of ``/proc/PROCESS/status`` [bytes]; 0 if unreadable."""
    total = 0
    with contextlib.suppress(OSError), open(f"/proc/{process}/status") as lines:
        for line in lines:
            if line.startswith(names):
                total += int(line.split()[1]) << 10
    return total


if __name__ == "__main__":
    race_, connection_, memory_, cores_, *command_ = sys.argv[1:]
    allowed = [*map(int, filter(None, cores_.split(",")))]
    sys.exit(main(int(race_), int(connection_), int(memory_), allowed, command_))
