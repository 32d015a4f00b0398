"""Clones a process in the middle of its race (Linux).

The clone must outlive the process that it was made from, and die with the fork server.
A plain fork gives a child of the race's process, so the clone is forked as a *sibling*:
the kernel's ``clone`` call with ``CLONE_PARENT`` makes it the fork server's own child from its
first moment, which it can end and reap, and which the kernel ends when it dies. (A fork
of a fork, with an orphan adopted by the fork server, does the same in twice the time.)

This call skips Python's and the C library's own preparations for a fork. They matter to
processes with threads; a race without a window has none, which is checked.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import socket
from typing import Any

_PR_SET_PDEATHSIG = 1
_CLONE_PARENT = 0x8000
#: Number of the system call ``clone``; with these arguments both platforms call it alike.
_SYS_CLONE = {"x86_64": 56, "aarch64": 220}

# Unlike CDLL, PyDLL keeps Python's lock during a call, so the clone starts with it.
_libc: Any = ctypes.PyDLL(None, use_errno=True) if os.name == "posix" else None


def die_with(parent: int) -> None:
    """Makes the kernel kill this process when its parent ends, or ends it if that has happened.

    Args:
        parent: process id of the parent.
    """
    _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def fork_beside(fork_server: int) -> int:
    """Forks this process into a sibling: a child of its parent, not of its own.

    Args:
        fork_server: process id of this process's parent.

    Returns:
        Process id of the new process; 0 in the new process itself.

    Raises:
        OSError: the system refuses, or this process has threads.
    """
    if len(os.listdir("/proc/self/task")) > 1:
        raise OSError("a process with several threads cannot be cloned")
    try:
        clone = _SYS_CLONE[platform.machine()]
    except KeyError:
        raise OSError(f"processes on {platform.machine()} cannot be cloned") from None
    pid: int = _libc.syscall(clone, _CLONE_PARENT | signal.SIGCHLD, 0, 0, 0, 0)
    if pid < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    if pid == 0:
        die_with(fork_server)
    return pid


def move_to(connection: socket.socket, session_fd: int, log_fd: int) -> socket.socket:
    """Replaces this process's connection and log.

    Args:
        connection: the old connection; another process may keep using it.
        session_fd: descriptor of the new connection.
        log_fd: descriptor of the new output file; it is closed.

    Returns:
        The new connection.
    """
    connection.close()
    os.dup2(log_fd, 1)
    os.dup2(log_fd, 2)
    os.close(log_fd)
    return socket.socket(fileno=session_fd)
