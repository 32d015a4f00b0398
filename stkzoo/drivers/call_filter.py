"""The system calls that the process of an agent can make, as a seccomp filter.

All other calls fail as if the kernel did not have them (``ENOSYS``), so libraries that do not need
a call fall back. The calls that are left out access other processes, other users of a file (locks,
leases, notifications), resources that Linux counts per user (timers, keys, queues, watches), memory
that is not counted, processor affinity, or large parts of the kernel. The library libseccomp builds
the filter; it is available in Debian and Ubuntu (package ``libseccomp2``).
"""

from __future__ import annotations

import ctypes
import errno
import functools
import platform
import selectors
import sys
from collections.abc import Iterable, Iterator
from typing import Any

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


@functools.cache
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
