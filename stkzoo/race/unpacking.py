"""Zips of agents, unpacked without harm to anything outside their folder."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path, PurePosixPath

from stkzoo.errors import ConfigError

__all__ = ["MAX_BYTES", "MAX_FILES", "MAX_RATIO", "members_of", "unpack"]

#: An agent with its weights takes up no more than this ...
MAX_BYTES = 1 << 30
#: ... in no more files than this ...
MAX_FILES = 10_000
#: ... and what is larger than a megabyte does not shrink by more than this when zipped.
MAX_RATIO = 200
_SMALL = 1 << 20
_BLOCK = 1 << 16


def members_of(path: Path) -> list[str]:
    """Names of the files in a zip.

    Raises:
        ConfigError: it is no zip, or one that :func:`unpack` refuses.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return [member.filename for member in _checked(archive, path)]
    except (ConfigError, MemoryError):
        raise
    except Exception as error:  # zipfile and zlib tell of damage in many ways
        raise _damaged(path, error) from error


def unpack(path: Path, folder: Path) -> None:
    """Unpacks a zip into a new folder.

    Everything in it becomes a plain file or folder, readable by its owner alone.

    Raises:
        ConfigError: the zip is damaged, encrypted, too large, or holds links or paths that
            lead out of it; the folder may hold a part of it then.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            budget = MAX_BYTES
            folder.mkdir(parents=True)
            for member in _checked(archive, path):
                budget -= _write(archive, member, folder / member.filename, budget, path)
    except (ConfigError, MemoryError):
        raise
    except Exception as error:  # zipfile and zlib tell of damage in many ways
        raise _damaged(path, error) from error


def _checked(archive: zipfile.ZipFile, path: Path) -> list[zipfile.ZipInfo]:
    """The zip's files, if there is nothing wrong with its list of them."""
    members = archive.infolist()
    if len(members) > MAX_FILES:
        raise _refused(path, f"it holds {len(members)} files, at most {MAX_FILES} may be")
    if sum(member.file_size for member in members) > MAX_BYTES:
        raise _refused(path, f"unpacked it is larger than {MAX_BYTES >> 20} MB")
    for member in members:
        _check(member, path)
    return [member for member in members if not member.is_dir()]


def _check(member: zipfile.ZipInfo, path: Path) -> None:
    name = PurePosixPath(member.filename)
    outside = name.is_absolute() or ".." in name.parts or "\\" in member.filename
    if outside or not name.parts or ":" in name.parts[0]:
        raise _refused(path, f"{member.filename!r} leads out of it")
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise _refused(path, f"{member.filename!r} is a link or a device, not a file")
    if member.flag_bits & 1:
        raise _refused(path, f"{member.filename!r} is encrypted")
    if member.file_size > max(_SMALL, MAX_RATIO * member.compress_size):
        raise _refused(path, f"{member.filename!r} would grow to {member.file_size} bytes")


def _write(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, target: Path, budget: int, path: Path
) -> int:
    """Writes one file and returns its size, whatever the zip says it is."""
    target.parent.mkdir(parents=True, exist_ok=True)
    size = 0
    with archive.open(member) as source, target.open("xb") as file:
        while block := source.read(_BLOCK):
            size += len(block)
            if size > budget:
                raise _refused(path, f"unpacked it is larger than {MAX_BYTES >> 20} MB")
            file.write(block)
    target.chmod(stat.S_IRUSR | stat.S_IWUSR)
    return size


def _refused(path: Path, why: str) -> ConfigError:
    return ConfigError(f"agent {str(path)!r} is not unpacked: {why}. Zip plain files only.")


def _damaged(path: Path, error: BaseException) -> ConfigError:
    if isinstance(error, OSError):
        return ConfigError(f"agent {str(path)!r} cannot be unpacked: {error}")
    return ConfigError(f"agent {str(path)!r} is no zip that can be read: {error}")
