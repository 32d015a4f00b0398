"""What the library needs of the machine: cores, a display, files, zips, locks, addresses."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import ipaddress
import os
import shutil
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from stkzoo.errors import ConfigError, StkzooError

try:
    import fcntl
    import resource
except ImportError:  # Windows
    fcntl = resource = None  # type: ignore[assignment]

__all__ = [
    "PART_FILES",
    "LockedTemporaryDirectory",
    "OwnDescriptor",
    "above_standard_streams",
    "atomic_write",
    "check_display",
    "check_writable",
    "cpu_count",
    "file_digest",
    "file_identity",
    "has_display",
    "ip_address_of",
    "is_loopback",
    "max_descriptors",
    "network_of",
    "remove_stale_directories",
    "try_lock",
    "write_text",
    "write_whole",
    "write_zip",
]

#: Glob pattern of the files that :func:`atomic_write` has not finished.
PART_FILES = ".*.part"

_PREFIX = "stkzoo-run-"


def cpu_count() -> int:
    """The number of CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def max_descriptors() -> int:
    """How many files and connections this process may have open (``ulimit -n``)."""
    if resource is None:
        return 8192  # of the C library on Windows
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sys.maxsize if soft == resource.RLIM_INFINITY else soft


def has_display() -> bool:
    """Whether a window can be opened."""
    names = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    return sys.platform != "linux" or any(map(os.environ.get, names))


def check_display(need: str, alternative: str = "") -> None:
    """Checks that there is a display for a window.

    Args:
        need: who needs it, for the message.
        alternative: what to do without it, such as ``" or render_mode=None"``.

    Raises:
        ConfigError: there is none.
    """
    if not has_display():
        raise ConfigError(
            f"{need}, but neither DISPLAY nor WAYLAND_DISPLAY names a display; start a desktop "
            f"session, or use `xvfb-run`{alternative}"
        )


def check_writable(path: str | os.PathLike[str], noun: str) -> Path:
    """Checks before the work that a file can be written when it is done.

    Args:
        path: the file; it may exist.
        noun: what it is, such as ``"the result"``, for the message.

    Raises:
        ConfigError: it is a folder, a device or a pipe, or its folder is missing or not writable.
    """
    file = Path(path)
    folder = file.absolute().parent
    if file.exists() and not file.is_file():
        remedy = "it is not a regular file; choose another name"
    elif not folder.is_dir():
        remedy = f"there is no folder {str(folder)!r}; make it first"
    elif not os.access(folder, os.W_OK):
        remedy = f"the folder {str(folder)!r} is not writable; choose another one"
    else:
        return file
    raise ConfigError(f"{noun} cannot be written to {str(path)!r}: {remedy}")


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary file to write, which replaces ``path`` when the block ends.

    The temporary file is flushed to the disk first: after a crash of the program or the
    machine, ``path`` holds the new content or the old one, never a part. An error in the
    block removes the temporary file.

    Raises:
        OSError: the file cannot be written, or ``path`` is a device, a pipe or a folder.
    """
    file = Path(path)
    if file.exists() and not file.is_file():  # replacing a device would destroy it
        raise FileExistsError(errno.EEXIST, "it exists and is not a regular file", str(file))
    folder = file.absolute().parent
    handle, name = tempfile.mkstemp(prefix=f".{file.name}.", suffix=".part", dir=folder)
    os.close(handle)
    part = Path(name)
    try:
        yield part
        part.chmod(0o644)
        _flush(part)
        part.replace(file)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink()
        raise
    with contextlib.suppress(OSError):  # some systems cannot flush folders
        _flush(folder)


@contextlib.contextmanager
def write_whole(
    path: str | os.PathLike[str], noun: str = "", error_type: type[StkzooError] = ConfigError
) -> Iterator[Path]:
    """:func:`atomic_write` with an error for users.

    Args:
        path: the file.
        noun: what it is, such as ``"the plot"``.
        error_type: the class of the error.

    Raises:
        StkzooError: of ``error_type``; the file cannot be written.
    """
    try:
        with atomic_write(path) as part:
            yield part
    except OSError as error:
        raise error_type(f"{noun} {path} cannot be written: {error}".lstrip()) from error


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file whole; see :func:`write_whole`."""
    with write_whole(path) as part:
        part.write_text(text, encoding="utf-8")


def write_zip(path: Path, members: Mapping[str, bytes]) -> None:
    """Writes a compressed zip; a fixed date makes equal contents equal files."""
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)


def try_lock(descriptor: int) -> bool:
    """Locks an open file for this process, unless another one has locked it.

    The system releases the lock when the process ends, however it ends. A system without such
    locks locks nothing.
    """
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
    return True


def file_digest(path: Path, digest: hashlib._Hash | hashlib.blake2b) -> str:
    """The digest of a file's content, as hexadecimal digits.

    Args:
        path: the file.
        digest: a new object of :mod:`hashlib`.
    """
    with path.open("rb") as stream:
        while block := stream.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def file_identity(descriptor: int) -> tuple[int, int] | None:
    """Device and inode of an open file or socket; ``None`` if the descriptor is closed."""
    try:
        status = os.fstat(descriptor)
    except OSError:
        return None
    return status.st_dev, status.st_ino


def above_standard_streams(descriptor: int) -> int:
    """The descriptor, or one of 3 or more in its place where a standard stream is closed.

    A library that writes to stdout or stderr would write into a file that has its number.
    """
    if descriptor > 2 or fcntl is None:
        return descriptor
    try:
        return fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(descriptor)


class OwnDescriptor:
    """A descriptor that a program may close behind our back, and use for a file of its own.

    ``os.closerange`` and libraries that make daemons close all descriptors. Then the number is
    somebody else's, and closing it would be an error in their file.

    Args:
        descriptor: an open one; this object closes it.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = above_standard_streams(descriptor)
        self._identity = file_identity(self._descriptor)
        self.closed = False

    def fileno(self) -> int:
        """The descriptor."""
        return self._descriptor

    @property
    def is_lost(self) -> bool:
        """Whether the descriptor is closed or is of another file by now."""
        return self.closed or file_identity(self._descriptor) != self._identity

    def close(self) -> None:
        """Closes the descriptor if it is still ours. You may call it again."""
        if not self.is_lost:
            os.close(self._descriptor)
        self.closed = True

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # the interpreter may be shutting down
            self.close()


class LockedTemporaryDirectory:
    """A temporary directory that does not outlive its program, however that ends.

    The directory is locked for as long as the program runs; the system releases the lock of
    a killed program. Each new directory removes those that are no longer locked. A context
    manager.

    Args:
        kind: what the directory is for; part of its name.

    Attributes:
        path: the directory.
    """

    def __init__(self, kind: str) -> None:
        remove_stale_directories()
        self._lock: OwnDescriptor | None = None
        is_locked = False
        while not is_locked:  # another program may remove the directory before it is locked
            self.path = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{kind}-"))
            is_locked = fcntl is None or self._acquire()

    def __enter__(self) -> LockedTemporaryDirectory:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Removes the directory. You may call it again."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.release()

    def release(self) -> None:
        """Releases the lock and leaves the directory in place."""
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.close()

    def _acquire(self) -> bool:
        with contextlib.suppress(FileNotFoundError, BlockingIOError):
            self._lock = OwnDescriptor(os.open(self.path, os.O_RDONLY))
            fcntl.flock(self._lock.fileno(), fcntl.LOCK_SH | fcntl.LOCK_NB)
            if self.path.exists():
                return True
        self.release()
        return False


def remove_stale_directories() -> None:
    """Removes the temporary directories of programs that were killed."""
    if fcntl is None:
        return
    with contextlib.suppress(OSError):
        for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
            with contextlib.suppress(OSError):
                _remove_if_unlocked(folder)


def _remove_if_unlocked(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        if os.fstat(handle).st_uid == os.geteuid() and try_lock(handle):
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(handle)


def ip_address_of(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """The IP address that a text is; ``None`` for a name."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def network_of(host: str) -> str:
    """The network of an address that counts as one client: of IPv6, the first 64 bits."""
    address = ip_address_of(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and not address.ipv4_mapped:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return host


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address or name."""
    address = ip_address_of(host)
    return host.lower() == "localhost" or (address is not None and address.is_loopback)
