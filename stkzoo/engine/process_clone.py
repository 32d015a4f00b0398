"""Forks a process that has a connection and a log of its own (Linux).

A child of the fork server is an ordinary fork. A clone of a race must outlive the process
that it was made from, and die with the fork server.
A plain fork gives a child of the race's process, so the clone is forked as a *sibling*:
the kernel's ``clone`` call with ``CLONE_PARENT`` makes it the fork server's own child from its
first moment, which it can end and reap, and which the kernel ends when it dies. (A fork
of a fork, with an orphan adopted by the fork server, does the same in twice the time.)

This call skips Python's and the C library's own preparations for a fork. They matter to
processes with threads; a race without a window has none, which is checked.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import platform
import signal
import socket
from collections.abc import Callable, Sequence
from typing import Any

from stkzoo.engine import wire

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


def serve_fork(
    connection: socket.socket, files: Sequence[int], fork: Callable[[], int], fork_server: int
) -> socket.socket | None:
    """Serves a request of kind :data:`~stkzoo.engine.wire.FORK`.

    Args:
        connection: this process's own connection, which the new process closes.
        files: descriptors of the new process's connection and log. They are closed here, so
            the program sees the end of that connection if no process takes it.
        fork: forks this process, as :func:`os.fork` does.
        fork_server: process id of the new process's parent.

    Returns:
        In the new process its connection; ``None`` in this one.
    """
    with contextlib.ExitStack() as on_exit:
        for file in files:
            on_exit.callback(os.close, file)
        if len(files) != 2:  # this process may open no more files
            return None
        session_fd, log_fd = files
        try:
            pid = fork()
        except OSError as error:
            with contextlib.suppress(OSError), socket.socket(fileno=os.dup(session_fd)) as session:
                wire.send_error(session, error)
            return None
        if pid:
            return None
        die_with(fork_server)
        for stream in (1, 2):
            os.dup2(log_fd, stream)
        connection.close()
        session = socket.socket(fileno=os.dup(session_fd))
    wire.send(session, wire.OK, str(os.getpid()).encode())
    return session


def fork_beside() -> int:
    """Forks this process into a sibling: a child of its parent, not of its own.

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
    return pid
