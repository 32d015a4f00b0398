"""How a process that runs a race makes a copy of itself in the middle of it (Linux).

The copy has to outlive the process that it was made of, and to die with the fork server
of them all. A plain fork gives a child of the race, so the copy is forked as a *sibling*:
the kernel's ``clone`` call with ``CLONE_PARENT`` makes it the fork server's own child from its
first moment, which it can end and reap, and which the kernel ends when it dies. (A fork
of a fork, with an orphan adopted by the fork server, does the same in twice the time.)

Python's and the C library's own preparations for a fork are left out by this call. They
matter to processes with threads; a race without a window has none, which is checked.
"""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import socket
from typing import Any

__all__ = ["die_with", "fork_beside", "move_to"]

_PR_SET_PDEATHSIG = 1
_CLONE_PARENT = 0x8000
#: The number of the system call ``clone``; with these arguments its form is the same on both.
_SYS_CLONE = {"x86_64": 56, "aarch64": 220}

# Unlike CDLL, PyDLL keeps Python's lock during a call, so that the copy starts with it.
_libc: Any = ctypes.PyDLL(None, use_errno=True) if os.name == "posix" else None


def die_with(parent: int) -> None:
    """Makes the kernel kill this process when its parent ends; ends it if that is over.

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
        raise OSError("a process with several threads cannot be copied")
    try:
        clone = _SYS_CLONE[platform.machine()]
    except KeyError:
        raise OSError(f"processes of {platform.machine()} cannot be copied") from None
    pid: int = _libc.syscall(clone, _CLONE_PARENT | signal.SIGCHLD, 0, 0, 0, 0)
    if pid < 0:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))
    if pid == 0:
        die_with(fork_server)
    return pid


def move_to(connection: socket.socket, session_fd: int, log_fd: int) -> socket.socket:
    """Leaves one connection and log for others.

    Args:
        connection: the connection to leave; others may go on with it.
        session_fd: descriptor of the new connection, which is taken over.
        log_fd: descriptor of the file to write output to from now on; it is closed.

    Returns:
        The new connection.
    """
    connection.close()
    os.dup2(log_fd, 1)
    os.dup2(log_fd, 2)
    os.close(log_fd)
    return socket.socket(fileno=session_fd)
