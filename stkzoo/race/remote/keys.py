"""Key files of servers and clients.

``NAME.secret`` contains both the secret and the public key; its owner must not share it.
``NAME.public`` contains the public key for others. Each line is a word and a key in ZeroMQ's Z85
encoding, so you can concatenate public files.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from stkzoo._reading import Unreadable, is_there, read_text
from stkzoo._schema import plain_text
from stkzoo.errors import ConfigError, reason
from stkzoo.race.remote.sockets import zmq_module

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
#: Maximum size of a key file [bytes].
_MAX_BYTES = 1 << 20
_KEY = re.compile(r"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")


@dataclass(frozen=True, slots=True)
class KeyPair:
    """A public and a secret key, in Z85 encoding.

    Attributes:
        public: key to share.
        secret: key to keep private.
    """

    public: str
    secret: str = field(repr=False)


def new_keys() -> KeyPair:
    """Generates a key pair.

    Raises:
        ConfigError: pyzmq is not installed, or was built without encryption.
    """
    zmq = zmq_module()
    if not zmq.has("curve"):
        raise ConfigError("this pyzmq was built without CURVE; install its wheel from PyPI")
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode(), secret.decode())


def new_key_files(name: str, folder: Path) -> tuple[Path, Path]:
    """Generates a key pair and writes its files.

    Args:
        name: name of the files, without ``.secret`` and ``.public``.
        folder: folder of the files.

    Returns:
        The paths of the secret file, which only its owner can read, and of the public file.

    Raises:
        ConfigError: the name is invalid, or a file already exists or cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"key name {name!r}, expected letters, digits, _ . and -")
    secret_file, public_file = folder / f"{name}.secret", folder / f"{name}.public"
    for file in (secret_file, public_file):
        if file.exists():
            raise ConfigError(f"{file} exists already; choose another name, or remove it first")
    keys = new_keys()
    public = f"public {keys.public} {name}\n"
    _write(secret_file, f"# A secret key: keep it to yourself.\n{public}secret {keys.secret}\n")
    _write(public_file, public, mode=0o644)
    return secret_file, public_file


def read_secret(file: str | Path) -> KeyPair:
    """Reads a key pair from a ``.secret`` file.

    Raises:
        ConfigError: the file does not exist, is not a secret key, or other users can read it.
    """
    path = Path(file).expanduser()
    words = dict(line[:2] for line in _lines_of(path))
    if "secret" not in words or "public" not in words:
        raise ConfigError(f"{path} is not a secret key; make one with: stkzoo keys new NAME")
    if os.name == "posix" and path.stat().st_mode & 0o077:
        raise ConfigError(f"other users can read the secret key {path}; first: chmod 600 {path}")
    return KeyPair(words["public"], words["secret"])


def read_public(source: str | Path) -> str:
    """Reads one public key.

    Args:
        source: path of a ``.public`` file, or the key itself (40 characters).

    Raises:
        ConfigError: the source is not exactly one public key.
    """
    keys = read_publics([source])
    if len(keys) != 1:
        raise ConfigError(f"{source} has {len(keys)} public keys, expected one")
    return next(iter(keys))


def read_publics(sources: Iterable[str | Path]) -> dict[str, str]:
    """Reads public keys.

    Args:
        sources: paths of ``.public`` files, of folders of such files, or of concatenated files; or
            the keys themselves.

    Returns:
        A mapping from keys to their names, which may be empty.

    Raises:
        ConfigError: a source cannot be read or contains no public key.
    """
    keys: dict[str, str] = {}
    for source in sources:
        path = Path(source).expanduser()
        if path.is_dir():
            files = sorted(path.glob("*.public"))
        elif not is_there(path) and _KEY.fullmatch(str(source)):
            keys[str(source)] = ""
            continue
        else:
            files = [path]
        found = {line[1]: " ".join(line[2:]) for file in files for line in _publics_of(file)}
        if not found:
            raise ConfigError(f"no public key in {source}; make one with: stkzoo keys new NAME")
        keys |= found
    return keys


def _publics_of(file: Path) -> Iterable[list[str]]:
    return (line for line in _lines_of(file) if line[0] == "public")


def _lines_of(path: Path) -> list[list[str]]:
    try:
        text = plain_text(read_text(path, _MAX_BYTES))
    except (OSError, Unreadable) as error:
        raise ConfigError(
            f"the key {path} cannot be read: {reason(error)}; make one with: stkzoo keys new NAME"
        ) from error
    lines = [line.split() for line in text.splitlines() if line and not line.startswith("# ")]
    for words in lines:
        if len(words) < 2 or words[0] not in ("public", "secret") or not _KEY.fullmatch(words[1]):
            raise ConfigError(
                f"{path} has an invalid line, expected 'public' or 'secret' and 40 characters"
            )
    return lines


def _write(file: Path, text: str, mode: int = 0o600) -> None:
    beside = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "w") as out:
            out.write(text)
        os.link(beside, file) if hasattr(os, "link") else os.rename(beside, file)
    except OSError as error:
        raise ConfigError(f"the key {file} cannot be written: {reason(error)}") from error
    finally:
        beside.unlink(missing_ok=True)
