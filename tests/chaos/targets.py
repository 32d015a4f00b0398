"""Readers of untrusted input, each as a function of bytes.

Each function accepts any bytes and processes them as a user's program would. It must succeed or
raise the reader's documented error; any other exception is a defect. Some inputs are used as
given. Others become part of an otherwise valid file, because its checksum would reject most of
them.
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
from functools import cache
from pathlib import Path

import msgspec

from stkzoo.agents import pretrained
from stkzoo.agents.pretrained.driver import CARD, WEIGHTS, read_numbers, read_policy
from stkzoo.drivers.files import find_files, unpack
from stkzoo.drivers.messages import (
    Action,
    Decided,
    Reply,
    decode,
    decode_observation,
    encode,
    encode_observation,
)
from stkzoo.engine.assets.headless import read_archive
from stkzoo.engine.assets.staging import Progress
from stkzoo.env.scenario import Scenario
from stkzoo.errors import AssetError, ConfigError, ProtocolError
from stkzoo.evaluation import (
    BenchmarkPlan,
    BenchmarkResult,
    TournamentPlan,
    TournamentResult,
    load_demonstrations,
    plan_benchmark,
    plan_tournament,
    record_demonstrations,
)
from stkzoo.race import RaceResult, run_race
from stkzoo.race.remote.access import read_servers
from stkzoo.race.remote.keys import new_key_files, read_public, read_secret
from stkzoo.race.remote.protocol import Act, Acted, Answer, ClientMessage, ServerMessage
from stkzoo.race.replay import ReplayError, ReplayWriter, load_replay, save_replay

__all__ = ["TARGETS", "Target"]

_DECODERS = [msgspec.msgpack.Decoder(kind) for kind in (Reply, ClientMessage, ServerMessage)]
_MEMORY = Path("/dev/shm")
_SCOUT = Path(pretrained.__file__).parent / "scout"


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
    return 16 * length + (1 << 20)


def _message_seeds() -> list[bytes]:
    import numpy as np

    from stkzoo.mdp.spaces import kart_action_space

    space = kart_action_space()
    space.seed(1)
    decided = Decided(Action.of(space.sample()), is_clipped=False)
    rows = (np.zeros(3, np.float32),) * 3
    return [
        encode(decided),
        encode(Acted(1, [Answer(0, decided, 0.1, is_usable=True)])),
        encode(Act(1, [(0, encode_observation({"rows": rows}))])),
        encode_observation({"rows": rows, "array": np.zeros(2), "text": "a", "number": 1}),
    ]


# ---------------------------------------------------------------------- replays


def _feed_replay(data: bytes) -> None:
    """Checks that a replay that can be read survives a round trip."""
    with _folder() as folder:
        file, again = folder / "race.stkz", folder / "again.stkz"
        file.write_bytes(_with_member(_a_replay(), data))
        with suppress(ReplayError):
            replay = load_replay(file)
            save_replay(replay, again)
            assert load_replay(again).controls.tobytes() == replay.controls.tobytes()


@cache
def _a_replay() -> bytes:
    with _folder() as folder:
        file = folder / "race.stkz"
        run_race(
            ["heuristic", "ai"], track="lighthouse", max_steps=5, listeners=[ReplayWriter(file)]
        )
        return file.read_bytes()


def _replay_seeds() -> list[bytes]:
    return [b"\0" + _a_replay(), *_member_seeds(_a_replay())]


# ---------------------------------------------------------------------- scenarios


def _feed_scenario(data: bytes) -> None:
    """Checks that a scenario that can be read survives a round trip."""
    with _folder() as folder:
        file, again = folder / "a.scenario", folder / "b.scenario"
        file.write_bytes(_with_member(_a_scenario(), data))
        with suppress(ConfigError):
            scenario = Scenario.load(file)
            scenario.save(again)
            assert Scenario.load(again).digest == scenario.digest


@cache
def _a_scenario() -> bytes:
    from stkzoo import race_v0

    with _folder() as folder, race_v0.parallel_env(num_kart=2, track="lighthouse") as env:
        env.reset(seed=1)
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        env.scenario().save(folder / "a.scenario")
        return (folder / "a.scenario").read_bytes()


def _scenario_seeds() -> list[bytes]:
    return [b"\0" + _a_scenario(), *_member_seeds(_a_scenario())]


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


# ---------------------------------------------------------------------- results and plans


def _feed_result(data: bytes) -> None:
    """Checks that a result that can be read survives a round trip."""
    text = data.decode(errors="replace")
    with suppress(ConfigError):
        result = RaceResult.from_json(text)
        assert RaceResult.from_json(result.to_json()) == result


@cache
def _a_result() -> RaceResult:
    return run_race(["heuristic", "ai"], track="lighthouse", max_steps=5)


def _result_seeds() -> list[bytes]:
    return [_a_result().to_json().encode()]


def _feed_plans(data: bytes) -> None:
    """Checks that plans and results of tournaments and benchmarks are read or refused."""
    text = data.decode(errors="replace")
    for kind in (TournamentPlan, TournamentResult, BenchmarkPlan, BenchmarkResult):
        with suppress(ConfigError):
            kind.from_json(text).to_json()


def _plan_seeds() -> list[bytes]:
    tournament = plan_tournament(["heuristic", "ai"], tracks=["lighthouse"], races=2)
    benchmark = plan_benchmark("heuristic", split=["lighthouse"], forms=["PA"], seeds=1)
    forms = (tournament, benchmark, BenchmarkResult(benchmark, ()))
    return [form.to_json().encode() for form in forms]


# ---------------------------------------------------------------------- keys and lists of servers


def _feed_keys(data: bytes) -> None:
    """Checks that a file of keys or servers is read or refused."""
    with _folder() as folder:
        file = folder / "a.secret"
        file.write_bytes(data)
        file.chmod(0o600)
        for read in (read_secret, read_public, read_servers):
            with suppress(ConfigError):
                read(file)


def _key_seeds() -> list[bytes]:
    with _folder() as folder:
        files = new_key_files("ada", folder)
        key = files[1].read_text().split()[1]
        servers = f"# mine\ntcp://127.0.0.1:5555 {key}\n127.0.0.1:* ada.public\n"
        return [*(file.read_bytes() for file in files), servers.encode()]


# ---------------------------------------------------------------------- demonstrations and cards


def _feed_demonstrations(data: bytes) -> None:
    """Checks that a dataset is read or refused."""
    with _folder() as folder:
        (folder / "a.safetensors").write_bytes(data)
        with suppress(ConfigError):
            load_demonstrations(folder / "a.safetensors")


@cache
def _demonstrations() -> bytes:
    with _folder() as folder:
        short = {"tracks": "lighthouse", "karts": 1, "max_steps": 5, "jobs": 1, "seeds": (1,)}
        record_demonstrations("heuristic", output=folder / "a.safetensors", **short)
        return (folder / "a.safetensors").read_bytes()


def _demonstration_seeds() -> list[bytes]:
    return [_demonstrations()]


def _feed_card(data: bytes) -> None:
    """Checks that the card or the weights of a learned agent are read or refused."""
    with _folder() as folder:
        name = WEIGHTS if data[:1] == b"\1" else CARD
        shutil.copytree(_SCOUT, folder / "scout")
        (folder / "scout" / name).write_bytes(data[1:])
        for read in (read_policy, read_numbers):
            with suppress(ConfigError):
                read(folder / "scout")


def _card_seeds() -> list[bytes]:
    return [b"\0" + (_SCOUT / CARD).read_bytes(), b"\1" + b"\x08" + bytes(7) + b"{}      "]


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


# ---------------------------------------------------------------------- helpers


@contextmanager
def _folder() -> Iterator[Path]:
    """Creates a temporary folder, in memory if possible."""
    parent = _MEMORY if os.access(_MEMORY, os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="stkzoo-fuzz-", dir=parent))
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


def _with_member(whole: bytes, data: bytes) -> bytes:
    """Returns the input itself, or a valid zip in which the input replaces one member."""
    if not data or data[0] % 4 == 0:
        return data[1:]
    members = _members(whole)
    names = list(members)
    members[names[data[0] % 4 % len(names)]] = data[1:]
    form = io.BytesIO()
    with zipfile.ZipFile(form, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return form.getvalue()


def _member_seeds(whole: bytes) -> list[bytes]:
    """Returns each member with the prefix byte that selects its place."""
    members = list(_members(whole).values())
    return [bytes([choice]) + members[choice % len(members)] for choice in range(1, 4)]


@cache
def _parts(whole: bytes) -> tuple[tuple[str, bytes], ...]:
    with zipfile.ZipFile(io.BytesIO(whole)) as archive:
        return tuple((name, archive.read(name)) for name in archive.namelist())


def _members(whole: bytes) -> dict[str, bytes]:
    return dict(_parts(whole))


#: All readers by name.
TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        Target("messages", _feed_messages, _message_seeds, _message_memory, _read_observation),
        Target("replays", _feed_replay, _replay_seeds),
        Target("scenarios", _feed_scenario, _scenario_seeds),
        Target("agent zips", _feed_agent_zip, _agent_zip_seeds),
        Target("results", _feed_result, _result_seeds),
        Target("plans", _feed_plans, _plan_seeds),
        Target("keys", _feed_keys, _key_seeds),
        Target("demonstrations", _feed_demonstrations, _demonstration_seeds),
        Target("cards", _feed_card, _card_seeds),
        Target("asset archives", _feed_archive, _archive_seeds),
    )
}
