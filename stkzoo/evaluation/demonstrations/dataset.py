"""A data set of demonstrations and its file.

The file is a plain ``.npz`` without pickles. For ``E`` episodes (one kart in one race) of ``N``
steps in all it has

- ``observations`` ``(N + E, ...)``: of every moment, including the last;
- ``actions`` ``(N, ...)``: the view's action after the observation of the same number;
- ``controls`` ``(N, 7)`` float32: the same as the game's own controls;
- ``rewards`` ``(N,)`` float64;
- ``lengths`` ``(E,)``: steps of each episode;
- ``about``: a JSON text: agent, view, tracks, seeds, versions, and facts of each episode.

Dict observations and actions have one array per entry, such as ``observations/continuous``.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from stkzoo._os import write_whole
from stkzoo._reading import Unreadable, read_arrays, read_json, reading
from stkzoo._schema import Count, Place, Positive, Within, typed
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError
from stkzoo.race.document import check_document

_KIND, _VERSION = "demonstrations", 1
#: Largest size of the arrays together, of ``about`` [bytes], and of an episode [steps].
_MAX_BYTES, _MAX_ABOUT, _MAX_LENGTH = 8 << 30, 64 << 20, 10_000_000
_BY_STEP = ("actions", "controls", "rewards")

Columns = dict[str, npt.NDArray[Any]]


def tree_of(name: str, columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    """The inverse of ``columns_of``: the array ``name``, or the dict of all ``name/key``.

    Raises:
        KeyError: there is neither.
    """
    if name in columns:
        return columns[name]
    inner = f"{name}/"
    keys = {column.removeprefix(inner).partition("/")[0] for column in columns if inner in column}
    if not keys:
        raise KeyError(name)
    return {key: tree_of(inner + key, columns) for key in sorted(keys)}


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """The kart and race of an episode, and how it ended.

    Attributes:
        race: number of the race in the data set.
        agent: id of the kart in it.
        track: where it drove.
        reverse: whether in reverse direction.
        seed: of the race.
        start_position: its place on the grid, 1 is in front.
        finish_time: since the start [s]; ``None`` if it did not finish.
        rank: its place at the end.
    """

    race: Count
    agent: str
    track: str
    reverse: bool
    seed: Count
    start_position: Place
    finish_time: Positive | None
    rank: Place


@dataclass(frozen=True, slots=True)
class DemoEpisode:
    """One kart's drive of ``T`` steps; arrays, or dicts of arrays, with time in front.

    Attributes:
        facts: its kart and race.
        observations: ``(T + 1, ...)``.
        actions: ``(T, ...)``, in the view: number ``t`` follows observation ``t``.
        controls: ``(T, 7)`` float32: acceleration, steer, brake, drift, fire, nitro, rescue.
        rewards: ``(T,)`` float64.
    """

    facts: EpisodeFacts
    observations: Any
    actions: Any
    controls: npt.NDArray[np.float32]
    rewards: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def is_finished(self) -> bool:
        """Whether the kart finished: the episode is terminated, else truncated."""
        return self.facts.finish_time is not None


@dataclass(frozen=True, slots=True)
class Demonstrations:
    """Recorded episodes.

    Attributes:
        plan: how they were recorded: ``agent``, ``view``, ``tracks``, ``directions``,
            ``seeds``, ``settings``, ``versions`` and more.
        facts: of every episode.
        lengths: steps of every episode, ``(E,)``.
        columns: the file's other arrays by name.
    """

    plan: Mapping[str, Any]
    facts: tuple[EpisodeFacts, ...]
    lengths: npt.NDArray[np.int64]
    columns: Columns

    def __len__(self) -> int:
        return len(self.facts)

    def __iter__(self) -> Iterator[DemoEpisode]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, number: int) -> DemoEpisode:
        if not 0 <= number < len(self):
            raise IndexError(f"episode {number} of {len(self)}")
        part = self.episode_columns(number)
        return DemoEpisode(
            self.facts[number],
            tree_of("observations", part),
            tree_of("actions", part),
            part["controls"],
            part["rewards"],
        )

    def episode_columns(self, number: int) -> Columns:
        """The part of each column that belongs to an episode."""
        begin = int(self.lengths[:number].sum())
        end = begin + int(self.lengths[number])
        return {
            name: column[begin:end]
            if is_by_step(name)
            else column[begin + number : end + number + 1]
            for name, column in self.columns.items()
        }

    @property
    def view(self) -> str:
        """The view's name."""
        return str(self.plan["view"])

    @property
    def num_steps(self) -> int:
        """Steps of all episodes together."""
        return int(self.lengths.sum())

    def pairs(self) -> tuple[Any, Any]:
        """Observations and the actions that followed, ``(N, ...)`` each, of all episodes."""
        last = np.cumsum(self.lengths + 1) - 1
        seen = {
            name: np.delete(column, last, axis=0)
            for name, column in self.columns.items()
            if not is_by_step(name)
        }
        return tree_of("observations", seen), tree_of("actions", self.columns)

    def to_dict(self) -> dict[str, Any]:
        """The file's ``about``, as JSON values."""
        head = {"type": _KIND, "schema_version": _VERSION}
        return {**head, **self.plan, "episodes": [asdict(facts) for facts in self.facts]}


def join(parts: Sequence[Demonstrations]) -> Demonstrations:
    """Joins data sets with the same plan, in order."""
    names = list(parts[0].columns)
    return Demonstrations(
        parts[0].plan,
        tuple(facts for part in parts for facts in part.facts),
        np.concatenate([part.lengths for part in parts]),
        {name: np.concatenate([part.columns[name] for part in parts]) for name in names},
    )


def save_demonstrations(demos: Demonstrations, path: str | os.PathLike[str]) -> None:
    """Writes a data set, atomically.

    Raises:
        ConfigError: the file cannot be written.
    """
    arrays: dict[str, Any] = {
        **demos.columns,
        "lengths": demos.lengths,
        "about": np.array(json.dumps(demos.to_dict())),
    }
    with write_whole(path, "the demonstrations") as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_demonstrations(path: str | os.PathLike[str]) -> Demonstrations:
    """Reads a data set.

    Args:
        path: a file that ``stkzoo demos`` wrote, or :func:`save_demonstrations`.

    Raises:
        ConfigError: the file is missing, damaged or something else.
    """
    if not Path(path).is_file():
        raise ConfigError(
            f"there are no demonstrations {str(path)!r}; record some: "
            f"stkzoo demos heuristic --output {path}"
        )
    with reading(f"{str(path)!r} cannot be read as demonstrations", "a file of stkzoo demos"):
        return _read(read_arrays(path, _MAX_BYTES))


@dataclass(frozen=True, slots=True)
class _About:
    """What must be in the file's ``about``."""

    view: Annotated[str, Within(1)]
    episodes: tuple[EpisodeFacts, ...]


def _read(arrays: Columns) -> Demonstrations:
    for name in ("about", "lengths"):
        if name not in arrays:
            raise Unreadable(f"it has no {name}")
    values = read_json(str(arrays.pop("about")), _MAX_ABOUT)
    check_document(values, _KIND, _VERSION)
    facts = typed(_About, values).episodes
    plan = {name: values[name] for name in values.keys() - {"type", "schema_version", "episodes"}}
    lengths = arrays.pop("lengths").astype(np.int64)
    demos = Demonstrations(typed(dict[str, Any], plan), facts, lengths, arrays)
    _check(demos)
    return demos


def _check(demos: Demonstrations) -> None:
    """Checks the lengths of all arrays.

    Raises:
        Unreadable: one is wrong or missing.
    """
    lengths, names = demos.lengths, {name.partition("/")[0] for name in demos.columns}
    if lengths.shape != (len(demos),) or ((lengths < 1) | (lengths > _MAX_LENGTH)).any():
        raise Unreadable(f"lengths is {lengths!s:.60}, with {len(demos)} episodes")
    if missing := {"observations", *_BY_STEP} - names:
        raise Unreadable(f"it has no {min(missing)}")
    for name, column in demos.columns.items():
        rows = demos.num_steps + (0 if is_by_step(name) else len(demos))
        if column.shape[:1] != (rows,):
            raise Unreadable(f"{name} has the shape {column.shape}, expected {rows} rows")
    for name, shape in (("controls", (demos.num_steps, len(CONTROLS))), ("rewards", lengths.shape)):
        column = demos.columns.get(name, lengths[:, None, None])
        if column.shape[1:] != shape[1:] or not np.isfinite(column).all():
            raise Unreadable(f"{name} has another shape than the steps, or is not finite")


def is_by_step(name: str) -> bool:
    """Whether a column has a row for each step; observations have one more for each episode."""
    return name.partition("/")[0] in _BY_STEP
