"""Forks of a process, each with its own connection and log (Linux).

A child of the fork server is an ordinary fork. A clone of a race must outlive the process
from which it was cloned, and end with the fork server. An ordinary fork would be a child of the
race's process, so the clone is forked as a *sibling*: the system call ``clone`` with
``CLONE_PARENT`` makes it a child of the fork server from the start. The fork server can end and
reap it, and the kernel ends it when the fork server ends. (A fork of a fork, whose orphan the fork
server adopts, does the same but takes twice as long.)

This call skips the preparations of Python and of the C library for a fork. They only matter to
processes with threads. A race without a window has none; :func:`fork_beside` checks this.
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
#: Numbers of the system call ``clone``. Both platforms take the arguments used here in one order.
_SYS_CLONE = {"x86_64": 56, "aarch64": 220}

# Unlike CDLL, PyDLL holds the GIL during a call, so the clone also starts with it.
_libc: Any = ctypes.PyDLL(None, use_errno=True)


def die_with(parent: int) -> None:
    """Makes the kernel kill this process when its parent ends.

    If the parent has already ended, this process exits.

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

    This process sends the id of the new process over its connection, so the program knows a new
    process that never answers.

    Args:
        connection: the connection of this process; the new process closes it.
        files: descriptors of the new process's connection and log, which this process closes.
        fork: function that forks this process, such as :func:`os.fork`.
        fork_server: process id of the new process's parent.

    Returns:
        The connection of the new process, in the new process; ``None`` in this process.
    """
    session, log = socket.socket(fileno=files[0]), files[1]
    problem = None
    try:
        pid = fork()
    except OSError as error:
        problem = error
    else:
        if not pid:
            die_with(fork_server)
            for stream in (1, 2):
                os.dup2(log, stream)
            os.close(log)
            connection.close()
            return session
    os.close(log)
    with session, contextlib.suppress(OSError):  # the program may have been interrupted
        if problem is None:
            wire.send(session, wire.OK, str(pid).encode())
        else:
            wire.send_error(session, problem)
    return None


def fork_beside() -> int:
    """Forks this process as a sibling: the new process is a child of this process's parent.

    Returns:
        Process id of the new process; 0 in the new process.

    Raises:
        OSError: the system call failed, the platform is not supported, or this process has
            several threads.
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
