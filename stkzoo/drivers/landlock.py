"""Landlock: a process of Linux gives up access to files, networks and other processes.

It needs no rights and no program, and holds for all that the process starts. What a kernel can
withhold grows with its version: files from 5.13, TCP from 6.7, signals from 6.12. Other processes
cannot be traced from the first version on. The calls are described in the kernel's
``Documentation/userspace-api/landlock.rst``.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
import sys
from collections.abc import Iterable

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446
_ASK_VERSION, _PATH_BENEATH, _PR_SET_NO_NEW_PRIVS = 1, 1, 38
#: Rights to files that each version can withhold, as bits.
_FILE_RIGHTS = {1: 0x1FFF, 2: 0x3FFF, 3: 0x7FFF, 4: 0x7FFF, 5: 0xFFFF}
_EXECUTE, _WRITE_FILE, _READ_FILE, _READ_DIR, _TRUNCATE = 1, 2, 4, 8, 1 << 14
_CAPSET, _CAPABILITIES_VERSION = {"x86_64": 126, "aarch64": 91}, 0x20080522
_TCP, _SCOPES = 3, 3  # bind and connect; abstract sockets and signals
_WITH_TCP, _WITH_SCOPES = 4, 6  # the versions that have them


def version() -> int:
    """The version of Landlock in this kernel; 0 if there is none."""
    if sys.platform != "linux":
        return 0
    known: int = _libc().syscall(_CREATE_RULESET, None, 0, _ASK_VERSION)
    return max(known, 0)


def has_tcp(known: int) -> bool:
    """Whether a version withholds TCP connections."""
    return known >= _WITH_TCP


def has_scopes(known: int) -> bool:
    """Whether a version withholds signals and abstract sockets."""
    return known >= _WITH_SCOPES


def restrict(
    readable: Iterable[str], writable: Iterable[str], listable: Iterable[str] = ()
) -> None:
    """Leaves this thread, and all that it starts, with nothing but these files.

    Root loses its capabilities too.

    Args:
        readable: folders and files to read and run.
        writable: folders and files to change, too.
        listable: folders whose names can be read, with those in them.

    Raises:
        OSError: the kernel refuses.
    """
    known = version()
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
    """Drops all capabilities; no program that is started later gets them back."""
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
