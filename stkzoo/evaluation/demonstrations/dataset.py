"""Datasets of demonstrations and their files.

The file has the safetensors format. An episode is the drive of one kart in one race. For
``E`` episodes with ``N`` steps in total, the file contains these arrays:

- ``observations`` ``(N + E, ...)``: observations, including the last one of each episode;
- ``actions`` ``(N, ...)``: actions of the view, each taken after the observation of its step;
- ``controls`` ``(N, 7)`` float32: the same actions as controls of the game;
- ``rewards`` ``(N,)`` float64;
- ``lengths`` ``(E,)``: number of steps of each episode;
- ``about`` in the metadata: JSON text with agent, view, tracks, seeds, versions, and facts about
  each episode.

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
from gymnasium import spaces
from msgspec import Meta

from stkzoo._arrays import read_arrays, write_arrays
from stkzoo._reading import Unreadable, read_json, reading
from stkzoo._schema import Count, Place, Positive
from stkzoo.config import NORMAL
from stkzoo.engine.snapshot import CONTROLS
from stkzoo.errors import ConfigError
from stkzoo.race.document import check_document

_KIND, _VERSION = "demonstrations", 1
#: Maximum total size of the arrays [bytes], size of ``about`` [bytes] and length of an episode.
_MAX_BYTES, _MAX_ABOUT, _MAX_LENGTH = 8 << 30, 64 << 20, 10_000_000
_BY_STEP = ("actions", "controls", "rewards")

Columns = dict[str, npt.NDArray[Any]]


def columns_of(
    name: str, space: spaces.Space[Any], values: Sequence[Any]
) -> dict[str, npt.NDArray[Any]]:
    """Stacks values along a leading time axis, with one array per dict entry (``name/key``).

    Args:
        name: name of the array.
        space: space of the values.
        values: one value per time step.
    """
    parts = getattr(space, "spaces", None)
    if not isinstance(parts, Mapping):
        shape = space.shape or ()
        return {name: np.array(values, space.dtype).reshape(len(values), *shape)}
    columns: dict[str, npt.NDArray[Any]] = {}
    for key, part in parts.items():
        columns |= columns_of(f"{name}/{key}", part, [value[key] for value in values])
    return columns


def tree_of(name: str, columns: Mapping[str, npt.NDArray[Any]]) -> Any:
    """Returns an array, or the nested dict of all arrays below a name; inverse of ``columns_of``.

    Args:
        name: name of the array, or prefix ``name`` of arrays ``name/key``.
        columns: arrays by name.

    Raises:
        KeyError: there is no such array or prefix.
    """
    if name in columns:
        return columns[name]
    inner = f"{name}/"
    parts = [column for column in columns if column.startswith(inner)]
    keys = {column.removeprefix(inner).partition("/")[0] for column in parts}
    if not keys:
        raise KeyError(name)
    return {key: tree_of(inner + key, columns) for key in sorted(keys)}


@dataclass(frozen=True, slots=True)
class EpisodeFacts:
    """The kart, race and outcome of an episode.

    Attributes:
        race: number of the race in the dataset.
        agent: id of the agent in the race.
        track: name of the track.
        reverse: whether the race was in reverse.
        seed: seed of the race.
        start_position: place of the kart on the grid; 1 is the front.
        finish_time: finish time [s]; ``None`` if the kart did not finish.
        rank: final rank of the kart.
        mode: mode of the race, one of :data:`stkzoo.config.RACE_MODES`.
    """

    race: Count
    agent: str
    track: str
    reverse: bool
    seed: Count
    start_position: Place
    finish_time: Positive | None
    rank: Place
    mode: str = NORMAL


@dataclass(frozen=True, slots=True)
class DemoEpisode:
    """The drive of one kart in ``T`` steps.

    Its data are arrays or dicts of arrays, whose first axis is time.

    Attributes:
        facts: kart, race and outcome.
        observations: ``(T + 1, ...)``: observations in the view.
        actions: ``(T, ...)``: actions in the view; action ``t`` follows observation ``t``.
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
        """Whether the kart finished. If so, the episode is terminated, otherwise truncated."""
        return self.facts.finish_time is not None


@dataclass(frozen=True, slots=True)
class Demonstrations:
    """A dataset of recorded episodes.

    Attributes:
        plan: how the episodes were recorded: ``agent``, ``view``, ``tracks``, ``directions``,
            ``seeds``, ``settings``, ``versions`` and more.
        facts: facts about each episode.
        lengths: ``(E,)`` int64: number of steps of each episode.
        columns: the other arrays of the file by name.
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
        """Returns the part of each column that belongs to an episode.

        Args:
            number: number of the episode.
        """
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
        """Name of the view."""
        return str(self.plan["view"])

    @property
    def num_steps(self) -> int:
        """Total number of steps of all episodes."""
        return int(self.lengths.sum())

    def pairs(self) -> tuple[Any, Any]:
        """Returns the observations of all episodes and the actions taken after them.

        Both have the shape ``(N, ...)``. The last observation of each episode is left out.
        """
        last = np.cumsum(self.lengths + 1) - 1
        seen = {
            name: np.delete(column, last, axis=0)
            for name, column in self.columns.items()
            if not is_by_step(name)
        }
        return tree_of("observations", seen), tree_of("actions", self.columns)

    def to_dict(self) -> dict[str, Any]:
        """Returns the file's ``about`` as JSON values."""
        head = {"type": _KIND, "schema_version": _VERSION}
        return {**head, **self.plan, "episodes": [asdict(facts) for facts in self.facts]}


def join(parts: Sequence[Demonstrations]) -> Demonstrations:
    """Returns the concatenation of datasets with the same plan."""
    names = list(parts[0].columns)
    return Demonstrations(
        parts[0].plan,
        tuple(facts for part in parts for facts in part.facts),
        np.concatenate([part.lengths for part in parts]),
        {name: np.concatenate([part.columns[name] for part in parts]) for name in names},
    )


def save_demonstrations(demos: Demonstrations, path: str | os.PathLike[str]) -> None:
    """Writes a dataset to a file, atomically.

    Args:
        demos: the dataset.
        path: the ``.safetensors`` file.

    Raises:
        ConfigError: the file cannot be written.
    """
    arrays = {**demos.columns, "lengths": demos.lengths}
    write_arrays(path, arrays, "the demonstrations", json.dumps(demos.to_dict()))


def load_demonstrations(path: str | os.PathLike[str]) -> Demonstrations:
    """Loads a dataset.

    Args:
        path: a file written by ``stkzoo demos`` or :func:`save_demonstrations`.

    Raises:
        ConfigError: the file is missing, damaged or of another kind.
    """
    if not Path(path).is_file():
        raise ConfigError(
            f"there are no demonstrations {str(path)!r}; record some: "
            f"stkzoo demos heuristic --output {path}"
        )
    with reading(f"{str(path)!r} cannot be read as demonstrations", "a file of stkzoo demos"):
        return _read(*read_arrays(path, _MAX_BYTES))


@dataclass(frozen=True, slots=True)
class _About:
    """The required values of the file's ``about``."""

    view: Annotated[str, Meta(min_length=1)]
    episodes: tuple[EpisodeFacts, ...]


def _read(arrays: Columns, text: str) -> Demonstrations:
    if not text or "lengths" not in arrays:
        raise Unreadable("it has no about or no lengths")
    check_document(text, _KIND, _VERSION, _MAX_ABOUT)
    facts = read_json(text, _About, _MAX_ABOUT).episodes
    values = read_json(text, dict[str, Any], _MAX_ABOUT)
    plan = {name: values[name] for name in values.keys() - {"type", "schema_version", "episodes"}}
    lengths = arrays.pop("lengths").astype(np.int64)
    demos = Demonstrations(plan, facts, lengths, arrays)
    _check(demos)
    return demos


def _check(demos: Demonstrations) -> None:
    """Checks the lengths and shapes of all arrays.

    Raises:
        Unreadable: an array is missing or has a wrong shape or value.
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
    """Returns whether a column has one row per step. Observations have one more per episode."""
    return name.partition("/")[0] in _BY_STEP
