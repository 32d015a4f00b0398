"""Interfaces to the operating system: cores, display, files, zips and addresses."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import ipaddress
import os
import resource
import secrets
import stat
import sys
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from stkzoo._schema import plain_text
from stkzoo.errors import ConfigError, StkzooError, reason

#: Glob pattern of the temporary files of :func:`write_whole`.
PART_FILES = ".stkzoo-*.part"
#: Environment variables that name a display for windows.
DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")
#: Size of a read of a large file [bytes].
_BLOCK = 1 << 20


def cpu_count() -> int:
    """Returns the number of CPU cores that this process can use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def max_descriptors() -> int:
    """Returns the maximum number of open files and connections of this process (``ulimit -n``)."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sys.maxsize if soft == resource.RLIM_INFINITY else soft


def lower_limit(limit: int, most: int) -> None:
    """Limits a resource of this process, without exceeding the hard limit that it already has.

    Args:
        limit: the resource, such as ``resource.RLIMIT_NOFILE``.
        most: the new soft and hard limit.
    """
    _, hard = resource.getrlimit(limit)
    most = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(limit, (most, most))


def display_problem() -> str:
    """Returns why no window can open; empty if the system has a display."""
    if sys.platform != "linux" or any(map(os.environ.get, DISPLAY_VARIABLES)):
        return ""
    return f"no display is named by {' or '.join(DISPLAY_VARIABLES)}"


def check_display(need: str, alternative: str = "") -> None:
    """Checks that the system has a display for windows.

    Args:
        need: what needs the display, as first clause of the error text.
        alternative: alternative in the error text, such as ``" or render_mode=None"``.

    Raises:
        ConfigError: there is no display.
    """
    if problem := display_problem():
        raise ConfigError(
            f"{need}, but {problem}; start a desktop session, or use `xvfb-run`{alternative}"
        )


def check_writable(path: str | os.PathLike[str], noun: str) -> Path:
    """Checks that a file can be written, before long work whose result it stores.

    Args:
        path: the file, which may exist.
        noun: name of the content in the error text, such as ``"the result"``.

    Returns:
        The file.

    Raises:
        ConfigError: ``path`` is a folder, a device or a pipe, its name is too long, or its folder
            is missing or not writable.
    """
    file = Path(path)
    try:
        problem = _problem_of(file)
    except OSError as error:
        problem = f"{reason(error)}; choose another name"
    if problem:
        raise ConfigError(f"{noun} cannot be written to {str(path)!r}: {problem}")
    return file


def _problem_of(file: Path) -> str:
    """Returns why a file cannot be written, and the remedy; empty if it can.

    Raises:
        OSError: the name is invalid, for example too long.
    """
    folder = file.absolute().parent
    if _is_special(file):
        return "it is not a regular file; choose another name"
    if not folder.is_dir():
        return f"there is no folder {str(folder)!r}; make it first"
    if not os.access(folder, os.W_OK):
        return f"the folder {str(folder)!r} is not writable; choose another one"
    return ""


@contextlib.contextmanager
def using_folder(folder: Path, noun: str) -> Iterator[None]:
    """Converts each OSError of a block that creates or opens an ``--output`` folder.

    Args:
        folder: the folder.
        noun: what the folder is for, such as ``"run"``.

    Raises:
        ConfigError: the folder cannot be used.
    """
    try:
        yield
    except OSError as error:
        is_file = isinstance(error, FileExistsError)  # mkdir's answer to a file
        why = os.strerror(errno.ENOTDIR) if is_file else reason(error)
        raise ConfigError(
            f"the {noun}'s folder {folder} cannot be used: {why}; choose another --output"
        ) from error


def make_folder(folder: Path, noun: str) -> None:
    """Creates an ``--output`` folder, unless it exists.

    Args:
        folder: the folder.
        noun: what the folder is for, such as ``"run"``.

    Raises:
        ConfigError: the folder cannot be created.
    """
    with using_folder(folder, noun):
        folder.mkdir(parents=True, exist_ok=True)


@contextlib.contextmanager
def write_whole(
    path: str | os.PathLike[str], noun: str = "", error_type: type[StkzooError] = ConfigError
) -> Iterator[Path]:
    """Yields a temporary file to write, which replaces ``path`` when the block ends.

    The temporary file is flushed to the disk before the replacement. After a crash of the program
    or the machine, ``path`` has either the new or the old content, never a part of it. After an
    error in the block, the temporary file is removed. An existing file keeps its permissions.

    Args:
        path: the file. If it is a link, the file replaces the link; what it names stays as it is.
        noun: name of the content in the error text, such as ``"the plot"``.
        error_type: class of the error.

    Raises:
        StkzooError: the file cannot be written, or ``path`` is a device, a pipe, a folder or a link
            to one of these; the error is an ``error_type``.
    """
    with writing(path, noun, error_type):
        target = Path(path).absolute()
        if _is_special(target):  # replacing a device would destroy it
            raise FileExistsError(errno.EEXIST, "it exists and is not a regular file", str(path))
        # The name is cut, because systems limit names to 255 bytes, which can be 63 letters.
        part = target.with_name(f".stkzoo-{target.name[:50]}.{secrets.token_hex(4)}.part")
        try:
            has_mode = target.exists() and not target.is_symlink()
            mode = stat.S_IMODE(target.stat().st_mode) if has_mode else None
            # The system applies the umask.
            granted = 0o666 if mode is None else mode & 0o666 | 0o600
            os.close(os.open(part, os.O_CREAT | os.O_EXCL | os.O_WRONLY, granted))
        except OSError as error:  # without the temporary name, which means nothing to users
            raise OSError(error.errno, error.strerror) from error
        try:
            yield part
            _flush(part)
            if mode is not None:
                part.chmod(mode)
            part.replace(target)
        except BaseException:
            with contextlib.suppress(OSError):
                part.unlink()
            raise
        with contextlib.suppress(OSError):  # some systems cannot flush folders
            _flush(target.parent)


@contextlib.contextmanager
def writing(
    path: str | os.PathLike[str], noun: str = "", error_type: type[StkzooError] = ConfigError
) -> Iterator[None]:
    """Converts an OSError of a block that writes a file.

    Args:
        path: the file.
        noun: name of the content in the error text, such as ``"the plot"``.
        error_type: class of the error.

    Raises:
        StkzooError: the file cannot be written; the error is an ``error_type``.
    """
    try:
        yield
    except OSError as error:
        why = str(error) if getattr(error, "filename", None) else reason(error)
        raise error_type(f"{noun} {path} cannot be written: {why}".lstrip()) from error


def sentence_of(error: StkzooError | OSError) -> str:
    """Returns the sentence of a command about an error of stkzoo or about an unusable file.

    Raises:
        OSError: the error is not about a file.
    """
    if isinstance(error, StkzooError):
        return plain_text(str(error))  # it may name strange files
    if error.filename is None:
        raise error
    problem = f"{error.filename} cannot be used: {reason(error)}"
    return plain_text(f"{problem}; move it away, or choose another")


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a UTF-8 text file atomically; see :func:`write_whole`.

    Args:
        path: the file.
        text: the text.
    """
    with write_whole(path) as part:
        part.write_text(text, encoding="utf-8")


def write_zip(path: Path, members: Mapping[str, bytes]) -> None:
    """Writes a compressed zip. All dates are fixed, so equal contents result in equal files.

    Args:
        path: the file.
        members: content of each member by name.
    """
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)


def file_digest(path: Path) -> str:
    """Returns the SHA-256 of a file's content as hexadecimal digits."""
    digest = hashlib.sha256()
    for block in read_blocks(path):
        digest.update(block)
    return digest.hexdigest()


def read_blocks(path: Path, most: int = sys.maxsize) -> Iterator[bytes]:
    """Yields the content of a file in blocks.

    Args:
        path: the file.
        most: maximum size of all blocks [bytes]; the rest of the file is left out.

    Raises:
        OSError: the file cannot be read, or is a device or a pipe, which would block.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    with path.open("rb") as stream:
        while block := stream.read(min(_BLOCK, most)):
            yield block
            most -= len(block)


def _is_special(file: Path) -> bool:
    """Returns whether a path is a folder, device or pipe, a link to one, or ``/dev/stdout``."""
    is_stream = file.is_symlink() and os.readlink(file).startswith("/proc/")
    return is_stream or (file.exists() and not file.is_file())


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def ip_address_of(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Returns the IP address in a text; ``None`` for a host name."""
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def is_loopback(host: str) -> bool:
    """Returns whether an address or name can only be reached from this machine."""
    address = ip_address_of(host)
    return host.lower() == "localhost" or (address is not None and address.is_loopback)
