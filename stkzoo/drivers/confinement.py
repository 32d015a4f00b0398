"""What the process of an agent gives up before it loads the agent.

Landlock restricts its access to files, networks and other processes. It needs no privileges and no
external program, and applies to all descendants of the process. Newer kernels support more
restrictions: files from 5.13, TCP from 6.7, signals from 6.12. All versions prevent tracing of
other processes. The system calls are described in the kernel's
``Documentation/userspace-api/landlock.rst``.

A seccomp filter restricts its system calls. The library libseccomp builds it; it is available in
Debian and Ubuntu (package ``libseccomp2``). Resource limits restrict what Linux counts per process
or per user.
"""

from __future__ import annotations

import ctypes
import errno
import functools
import os
import platform
import resource
import selectors
import struct
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from stkzoo._os import lower_limit

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


# ---------------------------------------------------------------------- system calls

# Calls that are not listed here fail as if the kernel did not have them (``ENOSYS``), so libraries
# that do not need a call fall back. The calls that are left out access other processes, other users
# of a file (locks, leases, notifications), resources that Linux counts per user (timers, keys,
# queues, watches), memory that is not counted, processor affinity, or large parts of the kernel.

_LIBRARY = "libseccomp.so.2"
_MACHINES = ("x86_64", "aarch64")
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000
_MASKED_EQUAL = 7  # comparison of an argument: its bits in a mask have a value
_INT = 0xFFFFFFFF  # the kernel ignores the upper bits of an ``int`` argument
_CALLS = {
    "reads and writes": """
        read write readv writev pread64 pwrite64 preadv pwritev preadv2 pwritev2 sendfile
        copy_file_range lseek close close_range dup dup2 dup3 pipe pipe2 eventfd eventfd2 poll ppoll
        select pselect6 fsync fdatasync ftruncate fallocate umask""",
    "files by name": """
        open openat creat stat fstat lstat newfstatat statx statfs fstatfs access faccessat
        faccessat2 readlink readlinkat getdents getdents64 getcwd chdir fchdir mkdir mkdirat rmdir
        unlink unlinkat rename renameat renameat2 link linkat symlink symlinkat truncate getxattr
        lgetxattr fgetxattr listxattr llistxattr flistxattr""",
    "memory": "brk munmap mremap mprotect madvise msync mincore membarrier",
    "processes and threads": """
        fork vfork execve execveat exit exit_group wait4 waitid set_tid_address rseq futex
        set_robust_list get_robust_list arch_prctl getpid getppid gettid getpgid getpgrp setpgid
        getsid getuid geteuid getresuid getgid getegid getresgid getgroups getrlimit setrlimit
        getrusage getpriority sched_yield sched_getaffinity sched_getparam sched_getscheduler
        sched_get_priority_min sched_get_priority_max getcpu""",
    "signals": """
        kill tkill tgkill rt_sigaction rt_sigprocmask rt_sigreturn rt_sigpending rt_sigtimedwait
        rt_sigsuspend sigaltstack restart_syscall pause alarm getitimer setitimer""",
    "time and the system": """
        time gettimeofday clock_gettime clock_getres clock_nanosleep nanosleep times uname sysinfo
        getrandom""",
    "local sockets": """
        bind listen connect accept accept4 shutdown getsockname getpeername getsockopt sendto
        recvfrom sendmsg recvmsg sendmmsg recvmmsg""",
}
#: Calls that change files of the user that can only be read, unless their mounts are read-only.
_ATTRIBUTES = (
    *("chmod", "fchmod", "fchmodat", "fchmodat2", "chown", "fchown", "lchown", "fchownat"),
    *("utime", "utimes", "futimesat", "utimensat"),
)
_SHARED, _ANONYMOUS, _LOCKED, _HUGE_PAGES = 1, 0x20, 0x2000, 0x40000  # flags of mmap()
_MAP_FLAGS = _SHARED | _ANONYMOUS | _LOCKED | _HUGE_PAGES
#: Flags ``CLONE_NEW*``, one for each kind of namespace.
_NAMESPACES = sum(1 << bit for bit in (7, 17, *range(25, 31)))
_UNIX, _SOCKET_LEVEL, _REUSE_ADDRESS = 1, 1, 2
#: Calls that are allowed with some arguments only: the number of an argument, a mask, and the
#: values of the bits in the mask.
_COMMANDS = (
    # duplicates and flags of descriptors, and the size of a pipe
    ("fcntl", 1, _INT, (0, 1, 2, 3, 4, 1030, 1032)),
    # flags of descriptors, bytes to read, and properties of a terminal
    ("ioctl", 1, _INT, (0x5421, 0x5450, 0x5451, 0x541B, 0x5401, 0x802C542A, 0x5413)),
    # signal at the parent's end, names of threads, and what a process can still gain
    ("prctl", 0, _INT, (1, 2, 3, 15, 16, 21, 23, 38, 39)),
    ("socket", 0, _INT, (_UNIX,)),
    ("socketpair", 0, _INT, (_UNIX,)),
    ("prlimit64", 0, _INT, (0,)),  # of the caller itself
    # clone3() passes its flags in memory, which a filter cannot read, so it is left out.
    ("clone", 0, _NAMESPACES, (0,)),
    # Shared memory without a file keeps its pages after they are unmapped, and then Linux counts
    # them for no process. Files in /dev/shm share memory; the size of that folder is limited.
    ("mmap", 3, _MAP_FLAGS, (0, _SHARED, _ANONYMOUS)),
)


class _ArgumentRule(ctypes.Structure):
    _fields_ = (
        ("argument", ctypes.c_uint),
        ("operator", ctypes.c_int),
        ("mask", ctypes.c_uint64),
        ("value", ctypes.c_uint64),
    )


def _has(argument: int, value: int, mask: int = _INT) -> _ArgumentRule:
    return _ArgumentRule(argument, _MASKED_EQUAL, mask, value)


def _rules(has_own_mounts: bool) -> Iterator[tuple[str, int, Iterable[_ArgumentRule]]]:
    """Yields calls, their results, and what must hold for their arguments."""
    for names in _CALLS.values():
        yield from ((name, _ALLOW, ()) for name in names.split())
    for name, argument, mask, values in _COMMANDS:
        yield from ((name, _ALLOW, (_has(argument, value, mask),)) for value in values)
    yield "setpriority", _ALLOW, (_has(0, 0), _has(1, 0))  # of the caller itself
    yield "setsockopt", _ALLOW, (_has(1, _SOCKET_LEVEL), _has(2, _REUSE_ADDRESS))
    # The result 0 pretends success. Linux divides CPU time among sessions, so an agent must not
    # create more of them.
    yield "setsid", _ERRNO, ()
    yield from ((name, _ALLOW if has_own_mounts else _ERRNO, ()) for name in _ATTRIBUTES)


def has_call_filter() -> bool:
    """Returns whether calls can be restricted: with libseccomp, on x86-64 and AArch64."""
    return _library() is not None


def restrict_calls(*, has_own_mounts: bool) -> None:
    """Restricts the system calls of this thread and everything that it starts.

    Does nothing where :func:`has_call_filter` is false.

    Args:
        has_own_mounts: whether read-only mounts protect the files that it must not change.

    Raises:
        OSError: the kernel rejects the filter.
    """
    library = _library()
    if library is None:
        return
    context = library.seccomp_init(_ERRNO | errno.ENOSYS)
    try:
        for name, action, arguments in _rules(has_own_mounts):
            number = library.seccomp_syscall_resolve_name(name.encode())
            if number < 0:  # an older library or this processor does not know the call
                continue
            rules = (_ArgumentRule * len([*arguments]))(*arguments)
            _check(library.seccomp_rule_add_array(context, action, number, len(rules), rules))
        _check(library.seccomp_load(context))
    finally:
        library.seccomp_release(context)
    # epoll is left out, because Linux counts its watches per user. Event loops use poll instead.
    selectors.DefaultSelector = selectors.PollSelector  # type: ignore[misc, assignment]


def _check(result: int) -> None:
    if result < 0:
        raise OSError(-result, "seccomp refuses its filter")


@functools.cache
def _library() -> Any:
    if sys.platform != "linux" or platform.machine() not in _MACHINES:
        return None
    try:
        library = ctypes.CDLL(_LIBRARY)
    except OSError:
        return None
    library.seccomp_init.argtypes = (ctypes.c_uint32,)
    library.seccomp_init.restype = ctypes.c_void_p
    library.seccomp_rule_add_array.argtypes = (
        ctypes.c_void_p,
        ctypes.c_uint32,
        ctypes.c_int,
        ctypes.c_uint,
        ctypes.c_void_p,
    )
    library.seccomp_load.argtypes = library.seccomp_release.argtypes = (ctypes.c_void_p,)
    return library
