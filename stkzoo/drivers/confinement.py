"""What the process of an agent gives up before it loads the agent.

Landlock restricts its access to files, networks and other processes. It needs no privileges and no
external program, and applies to all descendants of the process. Newer kernels support more
restrictions: files from 5.13, TCP from 6.7, signals from 6.12. All versions prevent tracing of
other processes. The system calls are described in the kernel's
``Documentation/userspace-api/landlock.rst``.

A seccomp filter blocks Linux system calls that no agent needs. The blocked calls access other
processes or change their limits and priorities, create namespaces, allocate memory that is not
counted, change processor affinity, or have a history of kernel vulnerabilities. The library
libseccomp builds the filter; it is available in Debian and Ubuntu (package ``libseccomp2``).
"""

from __future__ import annotations

import ctypes
import errno
import functools
import os
import platform
import resource
import struct
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from stkzoo._os import lower_limit

#: Maximum number of threads of all processes of an agent together.
_MAX_THREADS = 512
#: Limits of each process in a sandbox: number of open files, and size of a file [bytes].
_MAX_OPEN_FILES, _MAX_FILE_SIZE = 1024, 64 << 20


@dataclass(frozen=True, slots=True)
class Confinement:
    """What the process of an agent gives up before it loads the agent.

    Attributes:
        has_own_users: whether it has namespaces of its own for users and for the network.
        readable: paths that the agent can read under Landlock; empty without Landlock.
        writable: paths that the agent can change under Landlock.
        listable: folders that the agent can list under Landlock.
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
        for limit, most in {**limits, resource.RLIMIT_MSGQUEUE: 0}.items():
            lower_limit(limit, most)
        if self.readable:
            _restrict_files(self.readable, self.writable, self.listable)
        _restrict_calls(has_own_network=self.has_own_users)


# ---------------------------------------------------------------------- Landlock

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_ASK_VERSION, _PATH_BENEATH, _PR_SET_NO_NEW_PRIVS = 1, 1, 38
#: File access rights that each version of Landlock can restrict, as bits.
_FILE_RIGHTS = {1: 0x1FFF, 2: 0x3FFF, 3: 0x7FFF, 4: 0x7FFF, 5: 0xFFFF}
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR, _TRUNCATE = 1, 2, 4, 8, 1 << 14
_CAPSET, _CAPABILITIES_VERSION = {"x86_64": 126, "aarch64": 91}, 0x20080522
_TCP, _SCOPES = 3, 3  # bind and connect; abstract sockets and signals
_WITH_TCP, _WITH_SCOPES = 4, 6  # first versions that support them


def landlock_version() -> int:
    """Returns the version of Landlock in this kernel; 0 if there is none."""
    if sys.platform != "linux":
        return 0
    known: int = _libc().syscall(_CREATE_RULESET, None, 0, _ASK_VERSION)
    return max(known, 0)


def has_tcp(known: int) -> bool:
    """Returns whether a version can restrict TCP connections."""
    return known >= _WITH_TCP


def has_scopes(known: int) -> bool:
    """Returns whether a version can restrict signals and abstract sockets."""
    return known >= _WITH_SCOPES


def _restrict_files(
    readable: Iterable[str], writable: Iterable[str], listable: Iterable[str]
) -> None:
    """Restricts this thread, and everything that it starts, to these files.

    The process cannot gain new privileges. On x86-64 and AArch64, it also loses all capabilities.

    Args:
        readable: folders and files that the process can read and execute.
        writable: folders and files that the process can also change.
        listable: folders that the process can only list, including their subfolders.

    Raises:
        OSError: the kernel rejects a rule.
    """
    known = landlock_version()
    rights = _FILE_RIGHTS[min(known, max(_FILE_RIGHTS))]
    attributes = [rights]
    attributes += [_TCP] if has_tcp(known) else []
    attributes += [_SCOPES] if has_scopes(known) else []
    packed = struct.pack(f"{len(attributes)}Q", *attributes)
    ruleset = _call(_CREATE_RULESET, packed, len(packed), 0)
    try:
        for paths, allowed in (
            (readable, _EXECUTE | _READ_FILE | _READ_DIR),
            (writable, rights),
            (listable, _READ_DIR),
        ):
            for path in filter(os.path.exists, paths):
                _allow(ruleset, path, allowed)
        _libc().prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
        _call(_RESTRICT_SELF, ruleset, 0)
        _drop_capabilities()
    finally:
        os.close(ruleset)


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


# ---------------------------------------------------------------------- seccomp

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


def _has_bits(argument: int, bits: int) -> _ArgumentRule:
    return _ArgumentRule(argument, _MASKED_EQUAL, bits, bits)


def _is_int(argument: int, value: int) -> _ArgumentRule:
    """Compares an ``int`` argument. The kernel ignores its upper 32 bits."""
    return _ArgumentRule(argument, _MASKED_EQUAL, 0xFFFFFFFF, value)


def _is_not(argument: int, value: int) -> _ArgumentRule:
    return _ArgumentRule(argument, _NOT_EQUAL, value, 0)


#: A rule of the filter: a call, its result, and what must hold for its arguments.
_CallRule: TypeAlias = tuple[str, int, tuple[_ArgumentRule, ...]]
_RULES: tuple[_CallRule, ...] = (
    *((name, errno.EPERM, ()) for name in _REFUSED),
    *((name, errno.EPERM, (_is_not(0, 0),)) for name in _ONLY_ON_ITSELF),
    *(("clone", errno.EPERM, (_has_bits(0, flag),)) for flag in _NAMESPACES),
    # clone3() passes its flags in memory, which a filter cannot read. With ENOSYS, libraries fall
    # back to clone().
    ("clone3", errno.ENOSYS, ()),
    ("setpriority", errno.EPERM, (_is_not(0, _PRIO_PROCESS),)),
    ("setpriority", errno.EPERM, (_is_not(1, 0),)),
    # Shared memory keeps its pages after they are unmapped, and then Linux counts them for no
    # process. Files in /dev/shm still share memory; the size of that folder is limited.
    ("mmap", errno.EPERM, (_has_bits(3, _MAP_SHARED | _MAP_ANONYMOUS),)),
    # Libraries that create code at run time use memfd_create() where it exists.
    ("memfd_create", errno.ENOSYS, ()),
    # Messages that are sent without a copy hold whole huge pages, which are not counted.
    ("setsockopt", errno.EPERM, (_is_int(1, _SOL_SOCKET), _is_int(2, _SO_ZEROCOPY))),
    # Linux divides CPU time among sessions, so an agent must not create more of them. The result 0
    # pretends success.
    ("setsid", 0, ()),
)
#: Rules for sandboxes with a network namespace of their own, and for others.
_OWN_NETWORK: tuple[_CallRule, ...] = tuple(
    ("socket", errno.EPERM, (_is_int(0, family),)) for family in (_AF_PACKET, _AF_ALG, _AF_VSOCK)
)
_NO_NETWORK: tuple[_CallRule, ...] = (("socket", errno.EPERM, (_is_not(0, _AF_UNIX),)),)


@functools.cache
def has_call_filter() -> bool:
    """Returns whether libseccomp is available on this system."""
    return _library() is not None


def _restrict_calls(*, has_own_network: bool) -> None:
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
    sockets = _OWN_NETWORK if has_own_network else _NO_NETWORK
    context = library.seccomp_init(ctypes.c_uint32(_ALLOW))
    try:
        for name, result, arguments in (*_RULES, *sockets):
            number = library.seccomp_syscall_resolve_name(name.encode())
            if number == -1:  # an older library does not know the call
                continue
            rules = (_ArgumentRule * len(arguments))(*arguments)
            action = ctypes.c_uint32(_ERRNO | result)
            _check(library.seccomp_rule_add_array(context, action, number, len(rules), rules))
        _check(library.seccomp_load(context))
    finally:
        library.seccomp_release(context)


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
