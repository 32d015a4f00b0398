"""Seccomp filter: blocks Linux system calls that no agent needs.

The blocked calls access other processes or change their limits and priorities, create namespaces,
allocate memory that is not counted, change processor affinity, or have a history of kernel
vulnerabilities. The library libseccomp
builds the filter; it is available in Debian and Ubuntu (package ``libseccomp2``).
"""

from __future__ import annotations

import ctypes
import errno
import functools
import sys
from typing import Any

_LIBRARY = "libseccomp.so.2"
_ALLOW, _ERRNO = 0x7FFF0000, 0x00050000
_NOT_EQUAL, _MASKED_EQUAL = 1, 7  # comparisons of an argument
_REFUSED = (
    # other processes
    *("ptrace", "process_vm_readv", "process_vm_writev", "process_madvise", "pidfd_getfd", "kcmp"),
    # namespaces and mounts
    *("unshare", "setns", "mount", "umount2", "pivot_root", "chroot", "move_mount", "open_tree"),
    *("fsopen", "fsmount", "fspick", "mount_setattr"),
    # memory that is not counted for any process
    *("shmget", "semget", "msgget", "mq_open", "add_key", "request_key", "keyctl"),
    *("memfd_secret", "vmsplice"),
    # kernel interfaces with a large attack surface
    *("bpf", "perf_event_open", "userfaultfd", "io_uring_setup", "io_uring_enter"),
    *("io_uring_register", "fanotify_init", "name_to_handle_at", "open_by_handle_at"),
    # use of other agents' cores and disks
    *("sched_setaffinity", "ioprio_set"),
)
#: Calls whose first argument is a process. Only 0, the caller itself, is allowed.
_ONLY_ON_ITSELF = ("prlimit64", "sched_setscheduler", "sched_setparam", "sched_setattr")
#: Flags ``CLONE_NEW*``, one for each kind of namespace.
_NAMESPACES = (1 << 7, *(1 << bit for bit in (17, 25, 26, 27, 28, 29, 30)))
_PRIO_PROCESS = 0
_MAP_SHARED, _MAP_ANONYMOUS = 1, 0x20
_SOL_SOCKET, _SO_ZEROCOPY = 1, 60
_AF_UNIX, _AF_PACKET, _AF_ALG, _AF_VSOCK = 1, 17, 38, 40


class _ArgumentRule(ctypes.Structure):
    _fields_ = (
        ("argument", ctypes.c_uint),
        ("operator", ctypes.c_int),
        ("first", ctypes.c_uint64),
        ("second", ctypes.c_uint64),
    )


@functools.cache
def is_available() -> bool:
    """Returns whether libseccomp is available on this system."""
    return _library() is not None


def restrict(*, has_own_network: bool) -> None:
    """Blocks the system calls for this thread and everything that it starts.

    Does nothing without libseccomp.

    Args:
        has_own_network: whether the sandbox has its own network namespace. Otherwise, only Unix
            sockets are allowed.

    Raises:
        OSError: the kernel rejects the filter.
    """
    library = _library()
    if library is None:
        return
    context = library.seccomp_init(ctypes.c_uint32(_ALLOW))
    try:
        for name in _REFUSED:
            _refuse(library, context, name)
        for flag in _NAMESPACES:
            _refuse(library, context, "clone", _ArgumentRule(0, _MASKED_EQUAL, flag, flag))
        for name in _ONLY_ON_ITSELF:
            _refuse(library, context, name, _ArgumentRule(0, _NOT_EQUAL, 0, 0))
        for argument, allowed in ((0, _PRIO_PROCESS), (1, 0)):
            rule = _ArgumentRule(argument, _NOT_EQUAL, allowed, 0)
            _refuse(library, context, "setpriority", rule)
        # Shared memory keeps its pages after they are unmapped, and then Linux counts them for no
        # process. Files in /dev/shm still share memory; the size of that folder is limited.
        anonymous = _MAP_SHARED | _MAP_ANONYMOUS
        rule = _ArgumentRule(3, _MASKED_EQUAL, anonymous, anonymous)
        _refuse(library, context, "mmap", rule)
        # Libraries that create code at run time use memfd_create() where it exists.
        _refuse(library, context, "memfd_create", result=errno.ENOSYS)
        # Messages that are sent without a copy hold whole huge pages, which are not counted.
        zero_copy = _int_equal(1, _SOL_SOCKET), _int_equal(2, _SO_ZEROCOPY)
        _refuse(library, context, "setsockopt", *zero_copy)
        # clone3() passes its flags in memory, which a filter cannot read. With ENOSYS, libraries
        # fall back to clone().
        _refuse(library, context, "clone3", result=errno.ENOSYS)
        # Linux divides CPU time among sessions, so an agent must not create more of them. The
        # result 0 pretends success.
        _refuse(library, context, "setsid", result=0)
        for comparison in (
            [_int_equal(0, family) for family in (_AF_PACKET, _AF_ALG, _AF_VSOCK)]
            if has_own_network
            else [_ArgumentRule(0, _NOT_EQUAL, _AF_UNIX, 0)]
        ):
            _refuse(library, context, "socket", comparison)
        _check(library.seccomp_load(context))
    finally:
        library.seccomp_release(context)


def _int_equal(argument: int, value: int) -> _ArgumentRule:
    """Compares an ``int`` argument. The kernel ignores its upper 32 bits."""
    return _ArgumentRule(argument, _MASKED_EQUAL, 0xFFFFFFFF, value)


def _refuse(
    library: Any, context: Any, name: str, *comparisons: _ArgumentRule, result: int = errno.EPERM
) -> None:
    number = library.seccomp_syscall_resolve_name(name.encode())
    if number == -1:  # an older library does not know the call
        return
    rules = (_ArgumentRule * len(comparisons))(*comparisons)
    action = ctypes.c_uint32(_ERRNO | result)
    _check(library.seccomp_rule_add_array(context, action, number, len(comparisons), rules))


def _check(result: int) -> None:
    if result < 0:
        raise OSError(-result, "seccomp refuses its filter")


@functools.cache
def _library() -> Any:
    if sys.platform != "linux":
        return None
    try:
        library = ctypes.CDLL(_LIBRARY)
    except OSError:
        return None
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
