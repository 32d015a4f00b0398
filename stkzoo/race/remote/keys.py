"""Key files of servers and clients.

``NAME.secret`` has both halves of a key and stays with its owner; ``NAME.public`` is for others.
Each line is a word and a key in ZeroMQ's Z85 encoding, so public files can be concatenated.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from stkzoo._reading import Unreadable, is_there, read_text
from stkzoo.errors import ConfigError, reason
from stkzoo.race.remote.sockets import zmq_module

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
#: Largest size of a file of keys [bytes].
_MAX_BYTES = 1 << 20
_KEY = re.compile(r"[0-9a-zA-Z.\-:+=^!/*?&<>()\[\]{}@%$#]{40}")


@dataclass(frozen=True, slots=True)
class KeyPair:
    """Both halves of a key, in Z85 encoding.

    Attributes:
        public: the half to share.
        secret: the half to keep.
    """

    public: str
    secret: str = field(repr=False)


def new_keys() -> KeyPair:
    """A new pair of keys.

    Raises:
        ConfigError: pyzmq is missing, or was built without encryption.
    """
    zmq = zmq_module()
    if not zmq.has("curve"):
        raise ConfigError("this pyzmq was built without CURVE; install its wheel from PyPI")
    public, secret = zmq.curve_keypair()
    return KeyPair(public.decode(), secret.decode())


def new_key_files(name: str, folder: Path) -> tuple[Path, Path]:
    """Writes a new pair of keys.

    Args:
        name: of the files, before ``.secret`` and ``.public``.
        folder: their folder.

    Returns:
        The secret file, which only its owner can read, and the public one.

    Raises:
        ConfigError: the files exist already, or cannot be written.
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
    """Both halves from a ``.secret`` file.

    Raises:
        ConfigError: it does not exist, others can read it, or it is not a secret key.
    """
    path = Path(file).expanduser()
    words = dict(line[:2] for line in _lines_of(path))
    if "secret" not in words or "public" not in words:
        raise ConfigError(f"{path} is not a secret key; make one with: stkzoo keys new NAME")
    if os.name == "posix" and path.stat().st_mode & 0o077:
        raise ConfigError(f"other users can read the secret key {path}; first: chmod 600 {path}")
    return KeyPair(words["public"], words["secret"])


def read_public(source: str | Path) -> str:
    """One public key.

    Args:
        source: a ``.public`` file, or the 40 characters themselves.

    Raises:
        ConfigError: it is neither.
    """
    keys = read_publics([source])
    if len(keys) != 1:
        raise ConfigError(f"{source} has {len(keys)} public keys, expected one")
    return next(iter(keys))


def read_publics(sources: Iterable[str | Path]) -> dict[str, str]:
    """Public keys and their names.

    Args:
        sources: ``.public`` files, folders of them, files of many such lines, or keys.

    Raises:
        ConfigError: a source has no public key.
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
        text = read_text(path, _MAX_BYTES)
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
        raise ConfigError(f"the key {file} cannot be written: {error}") from error
    finally:
        beside.unlink(missing_ok=True)
