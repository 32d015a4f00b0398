"""Replays: recorded races that the engine reproduces bit for bit.

>>> from stkzoo.race import run_race
>>> from stkzoo.race.replay import ReplayWriter, load_replay, play_replay
>>> listeners = [ReplayWriter("/tmp/race.stkz")]
>>> _ = run_race(["heuristic", "ai"], track="lighthouse", max_steps=20, listeners=listeners)
>>> playback = play_replay(load_replay("/tmp/race.stkz"))
>>> playback.steps, playback.is_exact
(20, True)

A file is a zip of JSON and two arrays (``docs/reference/replays.md``). For any content, reading it
raises only :class:`ReplayError` and needs bounded time and memory.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from msgspec import Meta

from stkzoo._checks import check_type
from stkzoo._installation import pip_install
from stkzoo._os import check_writable, write_whole, write_zip
from stkzoo._reading import Unreadable, read_json, read_zip, reading
from stkzoo._schema import Count, Place, one_of
from stkzoo.config import NORMAL
from stkzoo.drivers.driver import Driver
from stkzoo.engine.assets import find_assets
from stkzoo.engine.snapshot import CONTROLS, Snapshot
from stkzoo.env.grid import RaceInfo
from stkzoo.env.options import RaceOptions
from stkzoo.errors import StkzooError
from stkzoo.mdp.spaces import action_of, controls_of
from stkzoo.race.listeners import RaceListener, RaceProgress
from stkzoo.race.result import RaceResult, versions_now
from stkzoo.race.runner import run_race

#: Size of one digest [bytes].
DIGEST_SIZE = 8

_ARRAYS = ("controls", "digests")
#: Facts of a race that are also fields of a replay and options of the environment.
_FACTS = ("track", "reverse", "mode", "laps", "difficulty")


@dataclass(frozen=True, slots=True)
class ReplayAgent:
    """One agent of a recorded race.

    Attributes:
        name: display name.
        source: the driver's source.
        is_game_ai: whether the game's AI drove the kart.
    """

    name: str
    source: str
    is_game_ai: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """A recorded race.

    Attributes:
        track: name of the track.
        reverse: whether the track was driven in reverse direction.
        laps: number of laps of the race.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        max_paths: number of track segments ahead in observations; ``None`` for all.
        step_size: game time of a step [s].
        seed: seed of the environment's reset.
        num_tracks: number of tracks from which ``track`` was drawn. It affects the random numbers
            that are drawn after the track.
        engine_seed: seed of the engine, which was drawn from the generator of ``seed``.
        start_positions: grid position of each agent, from 1 at the front.
        kart_types: model of each kart, in grid order.
        agents: the agents, in the environment's order.
        controls: ``(T, A, 7)`` float32, controls of each agent in each step, with the columns of
            :data:`~stkzoo.engine.snapshot.CONTROLS`; zeros for agents that the game's AI drives or
            that have finished.
        digests: ``(T + 1, 8)`` uint8, hash chain of :func:`next_digest`, from the grid on.
        status: the result's status; ``"partial"`` if an error ended the race.
        result: result of the race; ``None`` if an error ended it.
        versions: versions of the software.
        mode: mode of the race, one of :data:`stkzoo.config.RACE_MODES`.
        kart: model that the race gave all karts; ``None`` for the game's choice.
    """

    track: str
    reverse: bool
    laps: int
    difficulty: int
    max_paths: int | None
    step_size: float
    seed: Count
    num_tracks: Annotated[int, Meta(ge=1, le=10_000)]
    engine_seed: Count
    start_positions: tuple[Place, ...]
    kart_types: tuple[str, ...]
    agents: Annotated[tuple[ReplayAgent, ...], Meta(min_length=1, max_length=256)]
    controls: npt.NDArray[np.float32] = field(repr=False, default_factory=lambda: np.empty(0, "f4"))
    digests: npt.NDArray[np.uint8] = field(repr=False, default_factory=lambda: np.empty(0, "u1"))
    status: str
    result: RaceResult | None = field(repr=False)
    versions: Mapping[str, str]
    mode: str = NORMAL
    kart: str | None = None

    @property
    def steps(self) -> int:
        """Number of recorded steps."""
        return len(self.controls)

    @property
    def is_partial(self) -> bool:
        """Whether an interrupt or an error ended the race."""
        return self.result is None or self.status == "interrupted"

    def to_dict(self) -> dict[str, Any]:
        """Returns all fields except the arrays, as JSON values."""
        result = self.result.to_dict() if self.result else None
        values = {**asdict(self), "result": result, "steps": self.steps}
        return {name: value for name, value in values.items() if name not in _ARRAYS}


def next_digest(digest: bytes, snapshot: Snapshot) -> bytes:
    """Returns the next link of a hash chain over the states of all karts so far.

    The link is the BLAKE2b hash (8 bytes) of the previous link (empty for the first one), followed
    by the locations ``(K, 3)``, rotations ``(K, 4)`` and velocities ``(K, 3)`` of all karts as
    little-endian float32, in grid order.

    Args:
        digest: previous link; empty for the first one.
        snapshot: state of the karts.
    """
    link = hashlib.blake2b(digest, digest_size=DIGEST_SIZE)
    for name in ("location", "rotation", "velocity"):
        link.update(np.ascontiguousarray(snapshot.karts[name], "<f4").tobytes())
    return link.digest()


#: Version of the file format. It increases with each change that breaks older readers.
FORMAT = 1

_ABOUT, _CONTROLS, _DIGESTS = "race.json", "controls.f4", "digests.u1"

#: Maximum size of each member of the zip [bytes].
_MAX_MEMBER = {_ABOUT: 8 << 20, _CONTROLS: 256 << 20, _DIGESTS: 16 << 20}
#: Number of steps that are checked at once, to limit the memory for intermediate results.
_BLOCK = 4096
#: Lowest value of each control; the highest is 1.
_LOWEST = np.array([0, -1, 0, 0, 0, 0, 0], np.float32)


class ReplayError(StkzooError):
    """Raised when a replay cannot be read, written or played."""


def save_replay(replay: Replay, path: str | os.PathLike[str]) -> None:
    """Writes a replay atomically.

    Raises:
        ReplayError: the file cannot be written, or is too large to be read.
    """
    header = {"type": "stkzoo-replay", "format": FORMAT, **replay.to_dict()}
    members = {
        _ABOUT: json.dumps(header, indent=1).encode(),
        _CONTROLS: replay.controls.astype("<f4").tobytes(),
        _DIGESTS: replay.digests.tobytes(),
    }
    with write_whole(path, "the replay", ReplayError) as part:
        write_zip(part, members)
        with reading(
            f"the replay {path} cannot be written", "a race of fewer steps or karts", ReplayError
        ):
            read_zip(part, _MAX_MEMBER)


def load_replay(path: str | os.PathLike[str]) -> Replay:
    """Reads a replay.

    Raises:
        ReplayError: the file is missing, damaged or too large, or has another version.
    """
    expected = "a file from `stkzoo race --replay`"
    with reading(f"the replay {path} cannot be read", expected, ReplayError):
        return _replay_of(read_zip(path, _MAX_MEMBER))


def _replay_of(members: dict[str, bytes]) -> Replay:
    head = read_json(members[_ABOUT], _ReplayHead, _MAX_MEMBER[_ABOUT])
    if head.format != FORMAT:
        raise ReplayError(
            f"it has format {head.format}, this stkzoo reads format {FORMAT}; use the version of "
            "stkzoo that wrote it"
        )
    replay = read_json(members[_ABOUT], Replay, _MAX_MEMBER[_ABOUT])
    count = len(replay.agents)
    controls = _controls(members[_CONTROLS], count)
    size = DIGEST_SIZE * (len(controls) + 1)
    if head.steps != len(controls) or len(members[_DIGESTS]) != size:
        raise Unreadable(f"{_CONTROLS} has {len(controls)} steps, and steps or {_DIGESTS} do not")
    if sorted(replay.start_positions) != list(range(1, count + 1)):
        raise Unreadable("start_positions does not contain each place once")
    if len(replay.kart_types) != count:
        raise Unreadable(f"kart_types has {len(replay.kart_types)} entries, expected {count}")
    options = (*_FACTS, "max_paths", "step_size")
    values: dict[str, Any] = {name: getattr(replay, name) for name in options}
    RaceOptions(num_kart=count, **values)  # checks the values
    digests = np.frombuffer(members[_DIGESTS], np.uint8).reshape(-1, DIGEST_SIZE)
    return replace(replay, controls=controls, digests=digests)


@dataclass(frozen=True, slots=True)
class _ReplayHead:
    """What a replay's JSON contains besides its fields."""

    type: Annotated[str, one_of("stkzoo-replay")]
    format: int
    steps: Count = 0


def _controls(data: bytes, count: int) -> npt.NDArray[np.float32]:
    row = 4 * count * len(CONTROLS)
    if len(data) % row:
        raise Unreadable(f"{_CONTROLS} has {len(data)} bytes, expected a multiple of {row}")
    controls = np.frombuffer(data, "<f4").reshape(-1, count, len(CONTROLS))
    for start in range(0, len(controls), _BLOCK):
        block = controls[start : start + _BLOCK]
        buttons = block[..., 2:]
        is_valid = (block >= _LOWEST) & (block <= 1)  # false for NaN
        if not (is_valid.all() and np.isin(buttons, (0, 1)).all()):
            raise Unreadable(f"{_CONTROLS} has invalid controls")
    return controls.astype(np.float32, copy=False)


# ---------------------------------------------------------------------- recording


class ReplayWriter(RaceListener):
    """Writes a replay of its race.

    After an interrupt or an error, the file contains the race so far and is marked as partial.

    Args:
        path: path of the file. An existing file is replaced when the race has ended.

    Raises:
        ConfigError: the file cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = check_writable(path, "the replay")
        self._begin: tuple[RaceProgress, RaceInfo] | None = None
        self._controls: list[list[list[float]]] = []
        self._digests: list[bytes] = []

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._begin = race, race.race_info
        self._controls, self._digests = [], [next_digest(b"", race.snapshot)]

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        still = [0.0] * len(CONTROLS)
        actions, agents = race.actions, race.env.possible_agents
        self._controls.append([controls_of(actions[a]) if a in actions else still for a in agents])
        self._digests.append(next_digest(self._digests[-1], race.snapshot))

    def closed(self) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self.ended(None)

    def ended(self, result: RaceResult | None) -> None:
        """Writes the file if a race has started and the file is not yet written."""
        begin, self._begin = self._begin, None
        if begin is None:
            return
        race, info = begin
        env = race.env
        shape = (len(self._controls), len(env.possible_agents), len(CONTROLS))
        replay = Replay(
            **{name: getattr(info, name) for name in (*_FACTS, "kart_types")},
            kart=env.specs[0].kart or None,
            max_paths=env.options.max_paths,
            step_size=float(env.options.step_size),
            seed=race.seed,
            num_tracks=len(env.options.tracks(find_assets().tracks)),
            engine_seed=info.seed,
            start_positions=tuple(kart + 1 for kart in info.kart_indices),
            agents=tuple(
                ReplayAgent(race.names[agent], race.sources[agent], spec.use_ai)
                for agent, spec in zip(env.possible_agents, env.specs, strict=True)
            ),
            controls=np.array(self._controls, np.float32).reshape(shape),
            digests=np.frombuffer(b"".join(self._digests), np.uint8).reshape(-1, DIGEST_SIZE),
            status=result.status if result else "partial",
            result=result,
            versions=versions_now(),
        )
        save_replay(replay, self.path)


# ---------------------------------------------------------------------- playback

_DIFFERS = "differs"
_AGENT_FACTS = ("start_position", "rank", "finish_time", "laps", "distance", "reward")


@dataclass(frozen=True, slots=True)
class Playback:
    """Outcome of playing a replay.

    Attributes:
        result: result of the race; for an exact replay, the recorded result with the agents'
            recorded failures.
        steps: number of steps played.
        first_difference: number of steps after which the state of a kart first differs in any bit,
            0 on the grid; ``None`` if there is no difference.
        result_differences: descriptions of the differences between the recorded result and this
            one. If there are any although ``first_difference`` is ``None``, the file was modified.
    """

    result: RaceResult
    steps: int
    first_difference: int | None
    result_differences: tuple[str, ...] = ()

    @property
    def is_exact(self) -> bool:
        """Whether all states and the result equal the recording."""
        return self.first_difference is None and not self.result_differences


def play_replay(
    replay: Replay,
    *,
    listeners: Sequence[RaceListener] = (),
    to_the_end: bool = False,
    any_engine: bool = False,
) -> Playback:
    """Runs a recorded race again in the engine and compares the states of all karts.

    The drivers are not required: the replay contains their actions, and the game's AI is
    deterministic.

    Args:
        replay: the recorded race.
        listeners: listeners of the race; see :func:`~stkzoo.race.run_race`.
        to_the_end: continue after a difference.
        any_engine: also accept a replay of another engine version, which may behave differently.

    Raises:
        ReplayError: another engine version recorded the replay.
        ConfigError: its track or karts are missing.
        AssetError: the game's data is missing.
        EngineError: the game crashed or hung.
        RaceInterrupted: Ctrl-C interrupted the race.
    """
    _check_engine(replay, any_engine)
    comparison = _Comparison(replay, to_the_end)
    settings = {name: getattr(replay, name) for name in (*_FACTS, "kart", "seed", "max_paths")}
    # The number of tracks to draw from affects the random numbers that are drawn after it.
    settings["track"] = (replay.track,) * replay.num_tracks
    result = run_race(
        [_driver(replay, number) for number in range(len(replay.agents))],
        listeners=[comparison, *listeners],
        start_positions=replay.start_positions,
        **settings,
        max_steps=replay.steps + 1,  # the comparison ends the race one step earlier
        action_timeout=None,
    )
    return comparison.playback(result)


def other_versions(replay: Replay) -> str:
    """Returns this machine's versions that differ from those of a recording; empty if none do.

    Another version may be why a race differs.
    """
    check_type("replay", replay, Replay, "a Replay from load_replay(path)")
    here = versions_now()
    others = (name for name, version in here.items() if replay.versions.get(name) != version)
    return ", ".join(f"{name} {here[name]}" for name in others)


def _check_engine(replay: Replay, any_engine: bool) -> None:
    check_type("replay", replay, Replay, "a Replay from load_replay(path)")
    recorded, here = replay.versions.get("pystk2"), versions_now()["pystk2"]
    if recorded != here and not any_engine:
        raise ReplayError(
            f"the replay was recorded with version {recorded} of the engine; version {here} is "
            "installed and may drive differently: "
            f"{pip_install(f'PySuperTuxKart2=={recorded}')}, or "
            "play it anyway with any_engine=True (--any-engine)"
        )


def _driver(replay: Replay, number: int) -> Driver:
    agent = replay.agents[number]
    if agent.is_game_ai:
        return Driver(agent.name, None, agent.source)
    driver = recorded_driver(agent.name, replay.controls[:, number])
    return replace(driver, source=agent.source)


def recorded_driver(name: str, controls: npt.NDArray[np.float32]) -> Driver:
    """Returns a driver that repeats recorded controls ``(T, 7)`` and ignores its observations."""

    def make_actor(_: spaces.Space[Any], __: spaces.Space[Any], ___: int) -> Callable[..., Any]:
        rows = iter(controls)
        return lambda _: action_of(next(rows))

    return Driver.of_actor(name, make_actor)


class _Comparison(RaceListener):
    """Listener that compares the race with the recording and ends it at the same step."""

    def __init__(self, replay: Replay, to_the_end: bool) -> None:
        self._replay, self._to_the_end = replay, to_the_end
        self._digest = b""
        self.steps = 0
        self.first_difference: int | None = None

    def env_options(self) -> dict[str, Any]:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        return {"step_size": self._replay.step_size}

    def started(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._compare(race)
        if race.race_info.seed != self._replay.engine_seed:
            self._differ(race)

    def stepped(self, race: RaceProgress) -> None:
        """See :class:`~stkzoo.race.listeners.RaceListener`."""
        self._compare(race)

    def playback(self, result: RaceResult) -> Playback:
        """Returns the outcome of playing, from the result of the race."""
        recorded, replay = None, self._replay
        if self.steps == replay.steps and self.first_difference is None and not replay.is_partial:
            recorded = replay.result
        differences = () if recorded is None else _differences(recorded, result)
        if recorded is not None and not differences:
            result = replace(recorded, wall_time=result.wall_time)
        return Playback(result, self.steps, self.first_difference, differences)

    def _compare(self, race: RaceProgress) -> None:
        replay = self._replay
        self.steps = race.steps
        self._digest = next_digest(self._digest, race.snapshot)
        if self.first_difference is None and self._digest != replay.digests[race.steps].tobytes():
            self._differ(race)
        elif race.steps == replay.steps:
            race.stop(_DIFFERS if self.first_difference is not None else replay.status)

    def _differ(self, race: RaceProgress) -> None:
        self.first_difference = race.steps
        if not self._to_the_end or race.steps == self._replay.steps:
            race.stop(_DIFFERS)


def _differences(recorded: RaceResult, result: RaceResult) -> tuple[str, ...]:
    """Returns descriptions of the differences in what depends only on the race."""
    then, now = _facts(recorded), _facts(result)
    return tuple(
        f"{name} is {now.get(name)}, and {then.get(name)} in the file"
        for name in sorted(then.keys() | now.keys())
        if not _is_equal(then.get(name), now.get(name))
    )


def _facts(result: RaceResult) -> dict[str, Any]:
    names = (*_FACTS, "seed", "race_length", "steps")
    facts = {name: getattr(result, name) for name in names}
    for row in result.agents:
        facts |= {f"{row.agent}'s {name}": getattr(row, name) for name in _AGENT_FACTS}
    return facts


def _is_equal(one: Any, two: Any) -> bool:
    if isinstance(one, float) and isinstance(two, float):  # the kernel and numpy round differently
        return math.isclose(one, two, rel_tol=1e-4, abs_tol=1e-2)
    return bool(one == two)
