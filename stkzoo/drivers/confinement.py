"""What the process of an agent gives up before it loads the agent.

Landlock restricts its access to files, networks and other processes. It needs no privileges and no
external program, and applies to all descendants of the process. Newer kernels support more
restrictions: files from 5.13, TCP from 6.7, signals from 6.12. All versions prevent tracing of
other processes. The system calls are described in the kernel's
``Documentation/userspace-api/landlock.rst``.

A seccomp filter (:mod:`stkzoo.drivers.call_filter`) restricts its system calls, and resource limits
restrict what Linux counts per process or per user.
"""

from __future__ import annotations

import ctypes
import os
import platform
import resource
import struct
import sys
from dataclasses import dataclass, field

from stkzoo._os import lower_limit
from stkzoo.drivers.call_filter import restrict_calls

#: Maximum number of threads of all processes of an agent together.
_MAX_THREADS = 512
#: Limits of each process in a sandbox: number of open files, and size of a file [bytes]. The first
#: also limits descriptors of all processes of the user that are sent but not received.
_MAX_OPEN_FILES, _MAX_FILE_SIZE = 256, 64 << 20
#: Maximum number of pending signals and timers of all processes of the user.
_MAX_PENDING = 64


@dataclass(frozen=True, slots=True)
class Confinement:
    """What the process of an agent gives up before it loads the agent.

    Attributes:
        has_own_users: whether it has namespaces of its own for users and for mounts.
        readable: folders and files that the agent can read and execute under Landlock; empty
            without Landlock.
        writable: folders and files that the agent can also change under Landlock.
        listable: folders that the agent can only list under Landlock, with their subfolders.
    """

    has_own_users: bool
    readable: list[str] = field(default_factory=list)
    writable: list[str] = field(default_factory=list)
    listable: list[str] = field(default_factory=list)

    def apply(self) -> None:
        """Permanently drops the privileges that this process still has inside its sandbox.

        Raises:
            OSError: the kernel rejects a rule.
        """
        # In a user namespace of its own, the process limit counts only this agent's processes.
        limits = {resource.RLIMIT_NPROC: _MAX_THREADS} if self.has_own_users else {}
        limits |= {resource.RLIMIT_NOFILE: _MAX_OPEN_FILES, resource.RLIMIT_FSIZE: _MAX_FILE_SIZE}
        limits |= {resource.RLIMIT_SIGPENDING: _MAX_PENDING, resource.RLIMIT_MSGQUEUE: 0}
        limits |= {resource.RLIMIT_MEMLOCK: 0, resource.RLIMIT_RTPRIO: 0, resource.RLIMIT_NICE: 0}
        for limit, most in limits.items():
            lower_limit(limit, most)
        if self.readable:
            self._restrict_files()
        restrict_calls(has_own_mounts=self.has_own_users)

    def _restrict_files(self) -> None:
        """Restricts this thread, and everything that it starts, to these files.

        The process cannot gain new privileges. On x86-64 and AArch64, it also loses all
        capabilities.

        Raises:
            OSError: the kernel rejects a rule.
        """
        known = landlock_version()
        rights = _FILE_RIGHTS[min(known, max(_FILE_RIGHTS))]
        attributes = [rights]
        attributes += [_TCP] if known >= WITH_TCP else []
        attributes += [_SCOPES] if known >= WITH_SCOPES else []
        packed = struct.pack(f"{len(attributes)}Q", *attributes)
        ruleset = _call(_CREATE_RULESET, packed, len(packed), 0)
        try:
            for paths, allowed in (
                (self.readable, _EXECUTE | _READ_FILE | _READ_DIR),
                (self.writable, rights),
                (self.listable, _READ_DIR),
            ):
                for path in filter(os.path.exists, paths):
                    _allow(ruleset, path, allowed)
            _libc().prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
            _call(_RESTRICT_SELF, ruleset, 0)
            _drop_capabilities()
        finally:
            os.close(ruleset)


# ---------------------------------------------------------------------- Landlock

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_ASK_VERSION, _PATH_BENEATH, _PR_SET_NO_NEW_PRIVS = 1, 1, 38
#: File access rights that each version of Landlock can restrict, as bits.
_FILE_RIGHTS = {1: 0x1FFF, 2: 0x3FFF, 3: 0x7FFF, 4: 0x7FFF, 5: 0xFFFF}
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR, _TRUNCATE = 1, 2, 4, 8, 1 << 14
_CAPSET, _CAPABILITIES_VERSION = {"x86_64": 126, "aarch64": 91}, 0x20080522
_TCP, _SCOPES = 3, 3  # bind and connect; abstract sockets and signals
#: First versions of Landlock that restrict TCP, and signals and abstract sockets.
WITH_TCP, WITH_SCOPES = 4, 6


def landlock_version() -> int:
    """Returns the version of Landlock in this kernel; 0 if there is none."""
    if sys.platform != "linux":
        return 0
    known: int = _libc().syscall(_CREATE_RULESET, None, 0, _ASK_VERSION)
    return max(known, 0)


def _drop_capabilities() -> None:
    """Drops all capabilities. Programs that start later do not get them back."""
    header = struct.pack("=Ii", _CAPABILITIES_VERSION, 0)
    number = _CAPSET.get(platform.machine())
    if number is not None:
        _call(number, header, bytes(24))


def _allow(ruleset: int, path: str, rights: int) -> None:
    if not os.path.isdir(path):
        rights &= _EXECUTE | _WRITE_FILE | _READ_FILE | _TRUNCATE
    place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        _call(_ADD_RULE, ruleset, _PATH_BENEATH, struct.pack("=Qi", rights, place), 0)
    finally:
        os.close(place)


def _call(number: int, *arguments: int | bytes) -> int:
    result: int = _libc().syscall(number, *arguments)
    if result < 0:
        error = ctypes.get_errno()
        raise OSError(error, f"Landlock: {os.strerror(error)}")
    return result


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
