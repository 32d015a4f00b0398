"""Kinds of files that stkzoo reads, each with a valid file and a reader."""

from __future__ import annotations

import hashlib
import io
import json
import random
import tempfile
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from stkzoo import race_v0
from stkzoo._arrays import read_arrays, write_arrays
from stkzoo.agents.pretrained.driver import CARD, WEIGHTS, new_state, read_policy
from stkzoo.agents.training.common.matches import MatchRecord
from stkzoo.agents.training.common.run_folder import read_run_file
from stkzoo.agents.training.export import export_policy
from stkzoo.agents.training.league.league import LeagueArguments, _LeagueState
from stkzoo.agents.training.league.players import new_players
from stkzoo.engine.assets.tree import MARKER, read_marker
from stkzoo.env.scenario import Scenario
from stkzoo.evaluation import load_demonstrations, plan_benchmark, plan_tournament
from stkzoo.evaluation.benchmark.plan import BenchmarkPlan
from stkzoo.evaluation.benchmark.result import BenchmarkResult, race_outcomes
from stkzoo.evaluation.demonstrations.dataset import save_demonstrations
from stkzoo.evaluation.demonstrations.recorder import DemoRecorder, DemoView
from stkzoo.evaluation.tournament.film import FilmRecorder, MapFilm, draw_film
from stkzoo.evaluation.tournament.plan import TournamentPlan
from stkzoo.evaluation.tournament.standings import TournamentResult, summarize_tournament
from stkzoo.race import RaceResult, run_race
from stkzoo.race.document import Document
from stkzoo.race.remote.drivers import read_servers
from stkzoo.race.remote.sockets import new_key_files, read_publics, read_secret
from stkzoo.race.replay import ReplayWriter, load_replay
from stkzoo.suite import Entry, EntryPlan, plan_entry

_TRACK = "lighthouse"
_SERVERS = f"# ours\ntcp://a:1 a.public\ntcp://b:2 {'k' * 40}\n"
_SMALL = 50


@dataclass(frozen=True, slots=True)
class FileKind:
    """A kind of file.

    Attributes:
        name: name of the kind.
        valid: returns the text of a valid file.
        store: writes such a text, possibly damaged, to a folder; returns the file.
        read: reads the file and uses its content.
        is_json: whether the text is JSON.
    """

    name: str
    valid: Callable[[], str]
    store: Callable[[Path, bytes], Path]
    read: Callable[[Path], object]
    is_json: bool = True

    def write(self, folder: Path, text: str) -> Path:
        """Writes a text to a file in a folder; returns the file."""
        return self.store(folder, text.encode())

    def damage(
        self,
        folder: Path,
        source: random.Random,
        mutate: Callable[[Any, random.Random], Any],
        damaged_text: Callable[[str, random.Random], bytes],
    ) -> Path:
        """Writes a damaged file: usually with changed values if it is JSON, else damaged text."""
        text = self.valid()
        if not self.is_json or source.random() < 0.15:
            return self.store(folder, damaged_text(text, source))
        value = mutate(_parsed(text), source)
        return self.store(folder, json.dumps(value).encode())


@cache
def _parsed(text: str) -> Any:
    return json.loads(text)


def _as(name: str) -> Callable[[Path, bytes], Path]:
    """Returns a function that writes a text to a file with a name."""

    def store(folder: Path, data: bytes) -> Path:
        file = folder / name
        file.write_bytes(data)
        return file

    return store


# ---------------------------------------------------------------------- documents


def _document(kind: type[Document], valid: Callable[[], Document]) -> FileKind:
    @cache
    def text() -> str:
        return valid().to_json()

    def read(file: Path) -> None:
        found = kind.load(file)
        found.to_json()
        if isinstance(found, MapFilm):
            draw_film(found, "film")
        elif isinstance(found, TournamentPlan) and found.num_races < _SMALL:
            found.orders()

    return FileKind(kind.type_name, text, _as("file.json"), read)


@cache
def _race() -> tuple[RaceResult, MapFilm, bytes, bytes]:
    """Returns the result, film, replay and demonstrations of a race."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        film, demos = FilmRecorder(), DemoRecorder(1, DemoView("racing"), 1, 0)
        listeners = [film, demos, ReplayWriter(folder / "race.stkz")]
        drivers = ["heuristic", "ai", "random"]
        result = run_race(drivers, track=_TRACK, max_steps=20, seed=1, listeners=listeners)
        episodes = demos.episodes({"view": "racing"})
        assert episodes is not None
        save_demonstrations(episodes, folder / "demos.safetensors")
        replay, data = (
            (folder / "race.stkz").read_bytes(),
            (folder / "demos.safetensors").read_bytes(),
        )
        return result, film.film(), replay, data


def _tournament() -> TournamentPlan:
    return plan_tournament(["heuristic", "ai", "random"], tracks=[_TRACK], races=3, per_race=2)


@cache
def _benchmark() -> BenchmarkPlan:
    return plan_benchmark("heuristic", split=[_TRACK], forms=["PA"], seeds=1)


def _results(races: int) -> dict[int, RaceResult]:
    """Returns results of a batch: the same race for each number."""
    return dict.fromkeys(range(races), _race()[0])


def _tournament_result() -> TournamentResult:
    plan = _tournament()
    labels = {agent.label for agent in plan.agents}
    result = _race()[0]
    assert labels == {row.driver for row in result.agents}
    return summarize_tournament(plan, _results(3))


def _benchmark_result() -> BenchmarkResult:
    return BenchmarkResult(_benchmark(), race_outcomes(_benchmark(), _results(4)))


def _entry_plan() -> EntryPlan:
    return plan_entry("solo-general", "heuristic")


def _entry() -> Entry:
    plan = _entry_plan()
    races = race_outcomes(plan, _results(len(plan.races())))
    return Entry(plan, races, replays=("0" * 64,) * len(races))


# ---------------------------------------------------------------------- zips and arrays


def _members(data: bytes) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _in_zip(whole: Callable[[], bytes], member: str, ending: str) -> Callable[[Path, bytes], Path]:
    """Returns a function that writes a text as one member of an otherwise valid zip file."""

    def store(folder: Path, data: bytes) -> Path:
        file = folder / f"file{ending}"
        with zipfile.ZipFile(file, "w") as archive:
            for name, content in (_members(whole()) | {member: data}).items():
                archive.writestr(name, content)
        return file

    return store


@cache
def _scenario() -> bytes:
    with (
        tempfile.TemporaryDirectory() as folder,
        race_v0.parallel_env(num_kart=2, track=_TRACK) as env,
    ):
        env.reset(seed=1, options={"start": 100.0})
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})
        env.scenario().save(Path(folder, "a.scenario"))
        return Path(folder, "a.scenario").read_bytes()


def _store_demos(folder: Path, data: bytes) -> Path:
    """Writes a text as the entry ``about`` of a valid demonstration file."""
    file = folder / "demos.safetensors"
    file.write_bytes(_race()[3])
    arrays, _ = read_arrays(file, 1 << 20)
    write_arrays(file, arrays, "the demonstrations", data.decode(errors="replace"))
    return file


def _demos_text() -> str:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "demos.safetensors")
        file.write_bytes(_race()[3])
        return read_arrays(file, 1 << 20)[1]


def _read_demos(file: Path) -> None:
    demos = load_demonstrations(file)
    demos.pairs()
    assert demos.view
    for number in range(len(demos)):
        assert len(demos[number]) == demos.lengths[number]


# ---------------------------------------------------------------------- agents and training


@cache
def _agent() -> dict[str, bytes]:
    """Returns the files of an agent that chooses among plans, by name."""
    from stkzoo.agents.pretrained.policy import RacingPolicy
    from stkzoo.agents.pretrained.weights import save_weights

    with tempfile.TemporaryDirectory() as folder:
        weights = Path(folder, "policy-001.safetensors")
        save_weights(weights, RacingPolicy.of_plans_alone().weights)
        home = export_policy(weights, "swift", Path(folder, "agent"))
        return {name: (home / name).read_bytes() for name in (CARD, WEIGHTS)}


def _store_card(folder: Path, data: bytes) -> Path:
    (folder / WEIGHTS).write_bytes(_agent()[WEIGHTS])
    return _as(CARD)(folder, data)


def _header_size() -> int:
    return int.from_bytes(_agent()[WEIGHTS][:8], "little")


def _store_weights(folder: Path, data: bytes) -> Path:
    """Writes a text as the header of weights, with a matching card."""
    whole = _agent()[WEIGHTS]
    content = len(data).to_bytes(8, "little") + data + whole[8 + _header_size() :]
    card = _parsed(_agent()[CARD].decode()) | {"sha256": hashlib.sha256(content).hexdigest()}
    (folder / CARD).write_text(json.dumps(card))
    return _as(WEIGHTS)(folder, content)


def _read_agent(file: Path) -> None:
    read_policy(file.parent)
    new_state(file.parent)


@cache
def _league_text() -> str:
    members = [
        {"name": name, "player": "main", "turn": 0, "kart_steps": 5, "league_steps": 9}
        for name in ("start", "main-001")
    ]
    players = [asdict(player) for player in new_players(1, 1, 0)]
    match = asdict(MatchRecord(1, _TRACK, False, ["start", "main-001"]))
    content = {
        "arguments": asdict(LeagueArguments()),
        "turn": 1,
        "kart_steps": 9,
        "players": players,
        "members": members,
        "matches": [match],
        "ratings": {"start": [25.0, 20.0, 30.0]},
    }
    return json.dumps(content)


_CHAPTER = {"from": 0, "arguments": {"seed": 1, "tracks": [_TRACK]}, "rules": {"margin": 1.0}}


def _store_checkpoint(folder: Path, data: bytes) -> Path:
    import torch

    file = folder / "checkpoint.pt"
    torch.save({"facts": data.decode(errors="replace"), "network": {}}, file)
    return file


def _read_checkpoint(file: Path) -> None:
    from stkzoo.agents.training.common.run_folder import load_checkpoint
    from stkzoo.agents.training.ppo.run import PPOFacts

    load_checkpoint(file.parent, PPOFacts)


def _facts_text() -> str:
    facts = {
        "history": [_CHAPTER],
        "kart_steps": 5,
        "iteration": 1,
        "recent": [{"company": "alone", "reward": 9.5, "position": 1, "ratio": 1.1}],
        "duels": {"pool": [{"name": "start", "beaten": 0.4, "races": 3}], "reported": [0.5]},
    }
    return json.dumps(facts)


# ---------------------------------------------------------------------- keys and servers


@cache
def _key_texts() -> tuple[str, str]:
    with tempfile.TemporaryDirectory() as folder:
        secret, public = new_key_files("a", Path(folder))
        return secret.read_text(), public.read_text()


def _store_secret(folder: Path, data: bytes) -> Path:
    file = _as("a.secret")(folder, data)
    file.chmod(0o600)
    return file


def _json(name: str, file: str, content: Any, read: Callable[[Path], object]) -> FileKind:
    return FileKind(name, partial(json.dumps, content), _as(file), read)


def _all_kinds() -> list[FileKind]:
    marker = {"origin": "x", "headless": True, "layout": 1, "tracks": ["a"], "karts": ["b"]}
    replay, about = "race.json", "scenario.json"
    return [
        _document(RaceResult, lambda: _race()[0]),
        _document(TournamentResult, _tournament_result),
        _document(BenchmarkResult, _benchmark_result),
        _document(Entry, _entry),
        _document(MapFilm, lambda: _race()[1]),
        FileKind(
            "replay",
            lambda: _members(_race()[2])[replay].decode(),
            _in_zip(lambda: _race()[2], replay, ".stkz"),
            lambda file: load_replay(file).to_dict(),
        ),
        FileKind(
            "scenario",
            lambda: _members(_scenario())[about].decode(),
            _in_zip(_scenario, about, ".scenario"),
            lambda file: Scenario.load(file).roster,
        ),
        FileKind("demonstrations", _demos_text, _store_demos, _read_demos),
        FileKind("card", lambda: _agent()[CARD].decode(), _store_card, _read_agent),
        FileKind(
            "weights",
            lambda: _agent()[WEIGHTS][8 : 8 + _header_size()].decode(),
            _store_weights,
            _read_agent,
        ),
        _json("assets marker", MARKER, marker, lambda file: read_marker(file.parent)),
        FileKind("league", _league_text, _as("league.json"), partial(read_run_file, _LeagueState)),
        FileKind("checkpoint", _facts_text, _store_checkpoint, _read_checkpoint),
        FileKind("public key", lambda: _key_texts()[1], _as("a.public"),
                 lambda file: read_publics([file]), is_json=False),
        FileKind("secret key", lambda: _key_texts()[0], _store_secret, read_secret, is_json=False),
        FileKind("servers", lambda: _SERVERS, _as("servers.txt"), read_servers, is_json=False),
    ]  # fmt: skip


#: All kinds by name.
KINDS = {kind.name: kind for kind in _all_kinds()}
