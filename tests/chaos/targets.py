"""Readers of untrusted input for fuzzing, with initial inputs.

Each target processes bytes: input must be read, or raise the reader's own error. Any other
exception is a defect. There are messages, archives, whose files must stay inside their folder, and
files with several parts.
"""

from __future__ import annotations

import io
import os
import shutil
import stat
import tarfile
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from stkzoo.drivers.files import find_files, unpack
from stkzoo.drivers.instances import Decision
from stkzoo.drivers.messages import (
    Decided,
    Reply,
    decode,
    decode_observation,
    encode,
    encode_observation,
)
from stkzoo.engine.assets.headless import read_archive
from stkzoo.engine.assets.staging import Progress
from stkzoo.errors import AssetError, ConfigError, ProtocolError, StkzooError
from stkzoo.race.remote.protocol import Act, ClientMessage, ServerMessage
from tests.support.file_kinds import KINDS

__all__ = ["TARGETS", "Target"]

_DECODERS = [msgspec.msgpack.Decoder(kind) for kind in (Reply, ClientMessage, ServerMessage)]
_MEMORY = Path("/dev/shm")
#: Kinds of files with several parts; their text targets damage one part.
_BINARY_FILES = ("replay", "scenario", "demonstrations")


@dataclass(frozen=True, slots=True)
class Target:
    """A reader to fuzz.

    Attributes:
        name: what the reader reads.
        feed: processes an input; raises an exception if it finds a defect.
        seeds: returns the initial inputs.
        max_memory: returns the memory limit for an input of a given length [bytes].
        read: only reads the input. If given, the memory limit applies to it instead of ``feed``.
    """

    name: str
    feed: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]
    max_memory: Callable[[int], int] = lambda _: 64 << 20
    read: Callable[[bytes], None] | None = None


# ---------------------------------------------------------------------- messages


def _feed_messages(data: bytes) -> None:
    """Checks that a decoded observation can be encoded and decoded again without a change."""
    for decoder in _DECODERS:
        with suppress(ProtocolError):
            decode(decoder, data)
    with suppress(ProtocolError):
        again = encode_observation(decode_observation(data))
        assert encode_observation(decode_observation(again)) == again


def _read_observation(data: bytes) -> None:
    with suppress(ProtocolError):
        decode_observation(data)


def _message_memory(length: int) -> int:
    return 16 * length + (64 << 20)


def _message_seeds() -> list[bytes]:
    import numpy as np

    from stkzoo.mdp.spaces import kart_action_space

    space = kart_action_space()
    space.seed(1)
    decided = Decided.of(Decision(space.sample(), 0.0))
    rows = (np.zeros(3, np.float32),) * 3
    return [
        encode(decided),
        encode(Act(encode_observation({"rows": rows}))),
        encode_observation({"rows": rows, "array": np.zeros(2), "text": "a", "number": 1}),
    ]


# ---------------------------------------------------------------------- agents' zips


def _feed_agent_zip(data: bytes) -> None:
    """Checks that a zip is refused, or unpacked to regular files in its own folder."""
    with _folder() as folder:
        file, home = folder / "agent.zip", folder / "home" / "agent"
        file.write_bytes(_zip_of(data))
        with suppress(ConfigError):
            find_files(str(file))
        with suppress(ConfigError):
            unpack(file, home)
        assert {path.name for path in folder.iterdir()} <= {"agent.zip", "home"}
        for path in (folder / "home").rglob("*"):
            assert stat.S_IFMT(path.lstat().st_mode) in (stat.S_IFREG, stat.S_IFDIR), path


def _zip_of(data: bytes) -> bytes:
    """Returns the input itself, or a zip with the names and contents from the input."""
    if not data or data[0] % 4 == 0:
        return data[1:]
    form = io.BytesIO()
    with zipfile.ZipFile(form, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # zipfile warns of duplicate names
        for part in data[1:].split(b"\n"):
            name, _, content = part.partition(b"=")
            entry = zipfile.ZipInfo(name[1:].decode("utf-8", "surrogateescape") or "a")
            entry.external_attr = (name[0] << 8 if name else 0o100) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED if data[0] % 4 == 1 else zipfile.ZIP_STORED
            with suppress(UnicodeEncodeError, ValueError):
                archive.writestr(entry, content * (data[0] if data[0] > 250 else 1))
    return form.getvalue()


def _agent_zip_seeds() -> list[bytes]:
    words = (
        b"\x81pystk_actor.py=import os\n\x81stk_actor/a.py=x\n\x81../out=y\n\xa1link=/etc/passwd"
    )
    return [b"\x01" + words, b"\x02" + words, b"\x00" + _zip_of(b"\x01" + words), b"\xfd" + words]


# ---------------------------------------------------------------------- archives of game data


def _feed_archive(data: bytes) -> None:
    """Checks that an archive is refused, or unpacked to regular files in its own folder."""
    with _folder() as folder:
        file, target = folder / "pack.tar.xz", folder / "target"
        target.mkdir()
        file.write_bytes(_tar_of(data))
        with suppress(AssetError):
            read_archive(file, target, Progress())
        assert {path.name for path in folder.iterdir()} == {"pack.tar.xz", "target"}
        for path in target.rglob("*"):
            assert stat.S_IFMT(path.lstat().st_mode) in (stat.S_IFREG, stat.S_IFDIR), path


def _tar_of(data: bytes) -> bytes:
    """Returns the input itself, or an archive with the names and contents from the input."""
    if not data or data[0] % 4 == 0:
        return data[1:]
    form = io.BytesIO()
    with tarfile.open(fileobj=form, mode="w:xz", preset=0) as archive:
        parts = [part.partition(b"=") for part in data[1:].split(b"\n")]
        for name, _, content in parts:
            kinds = (tarfile.REGTYPE, tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE)
            kind = kinds[name[0] % 4] if name and data[0] % 4 == 1 else tarfile.REGTYPE
            _add(archive, name[1:].decode(errors="replace"), content, kind)
    return form.getvalue()


def _add(
    archive: tarfile.TarFile, name: str, content: bytes, kind: bytes = tarfile.REGTYPE
) -> None:
    member = tarfile.TarInfo(name)
    member.type = kind
    member.size = len(content) if kind == tarfile.REGTYPE else 0
    member.linkname = "/etc/passwd"
    with suppress(ValueError, UnicodeError):
        archive.addfile(member, io.BytesIO(content))


def _archive_seeds() -> list[bytes]:
    words = b"\x01data/karts/gnu/kart.xml=<x/>\n\x01data/tracks/a/track.xml=<x/>\n\x01../out=y"
    return [b"\x01" + words, b"\x02" + words, b"\x00" + _tar_of(b"\x02" + words)]


# ---------------------------------------------------------------------- files


def _feed_binary_file(data: bytes) -> None:
    """Checks that a damaged binary file is read or refused by each reader of such files."""
    with _folder() as folder:
        for name in _BINARY_FILES:
            file = KINDS[name].write(folder, KINDS[name].valid())
            file.write_bytes(data)
            with suppress(StkzooError):
                KINDS[name].read(file)


def _binary_file_seeds() -> list[bytes]:
    with _folder() as folder:
        files = [KINDS[name].write(folder, KINDS[name].valid()) for name in _BINARY_FILES]
        return [file.read_bytes() for file in files]


@contextmanager
def _folder() -> Iterator[Path]:
    """Creates a temporary folder, in memory if possible."""
    parent = _MEMORY if os.access(_MEMORY, os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="stkzoo-fuzz-", dir=parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


#: All readers by name.
TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        Target("messages", _feed_messages, _message_seeds, _message_memory, _read_observation),
        Target("agent zips", _feed_agent_zip, _agent_zip_seeds),
        Target("asset archives", _feed_archive, _archive_seeds),
        Target("binary files", _feed_binary_file, _binary_file_seeds),
    )
}
