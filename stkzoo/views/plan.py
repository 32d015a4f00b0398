"""Plans: what the kernel does in place of a chain of wrappers.

A :class:`ViewPlan` starts as the ``full`` view. Each wrapper, starting with the innermost, adds
itself (``compile_into``) until one cannot. The kernel then replaces these wrappers: it makes their
observations directly from the game's records, and controls directly from their actions.

A *batch* of observations has a row for each of several agents: it is an array; a list of texts; or
a dict of batches by entry. The kernel's ``new_batch`` makes batches, and its ``split_batch``
returns their rows.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.engine.snapshot import CONTROLS
from stkzoo.kernel import ActionReader, CarController, KartObserver
from stkzoo.mdp.spaces import extras_of, kart_action_space

if TYPE_CHECKING:
    from stkzoo.wrappers.control import ControlWrapper

IntArray = npt.NDArray[np.intp]

#: One number of an action: lowest value, highest value, whether it is an integer, its column in
#: the controls, and for choices a table of what each choice adds to the controls.
Entry = tuple[float, float, bool, int, Any]
#: All numbers of an action under one key.
Leaf = tuple[Entry, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Seats:
    """Where some agents of a race sit. One step passes the same seats to all of its phases.

    Attributes:
        agents: ids of the agents.
        karts: ``(A,)`` kart of each agent.
        rows: ``(A,)`` row of each agent in the controls, meaningless for agents that the game's AI
            drives.
        num_rows: number of rows of the controls.
        numbers: ``(A,)`` number of each agent among all agents of the race.
        order: ``(A,)`` number of each agent among these agents: 0, 1, ...
    """

    agents: tuple[str, ...]
    karts: IntArray
    rows: IntArray
    num_rows: int
    numbers: IntArray
    order: IntArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "order", np.arange(len(self.agents)))

    def at(self, places: IntArray) -> Seats:
        """Returns the seats of the agents at some places."""
        agents = tuple(self.agents[place] for place in places)
        karts, rows, numbers = self.karts[places], self.rows[places], self.numbers[places]
        return Seats(agents, karts, rows, self.num_rows, numbers)


class ObservationSource(Protocol):
    """A race at one moment, as the source of observations.

    Attributes:
        course: the track's ``TrackGraph``, the number of observed segments, and the karts' models.
        step_size: game time of one step [s].
        track_map: the :class:`~stkzoo.engine.track.TrackMap`.
        snapshot: snapshot of all karts.
    """

    course: tuple[Any, int, tuple[str, ...]]
    step_size: float
    track_map: Any
    snapshot: Any

    def standing_into(self, karts: IntArray, rows: IntArray, batch: Any, column: int) -> None:
        """Writes the standing of some karts into rows of an array, from a column on."""

    def ground_ahead(self, karts: IntArray) -> Mapping[str, npt.NDArray[Any]]:
        """Returns the observation entries of the ground ahead of some karts."""


class RowObserver(Protocol):
    """Makes the observations of karts as rows of a batch."""

    def observe_into(
        self, source: ObservationSource, karts: IntArray, rows: IntArray, batch: Any
    ) -> None:
        """Writes the karts' observations into rows of a batch.

        Args:
            source: the race at this moment.
            karts: ``(A,)`` indices of the karts.
            rows: ``(A,)`` row of each kart.
            batch: an array with one row per slot, or a dict of arrays and lists by entry.
        """


class ViewPlan:
    """What the kernel does for the compiled wrappers of one agent.

    Attributes:
        parts: entries of the observation; for each the array that has it, alone or with others as a
            vector.
        ones: length of the one-hot encoding of each choice that has one.
        sizes: fixed lengths of the lists ``items``, ``karts`` and ``paths``, if they have one.
        is_polar: whether positions are two angles and a distance.
        uses: ``(2, n)`` bool, which actions press nitro, and which fire, if there is an action
            mask.
        observer: custom observer, if there is one.
        leaves: numbers of an action by key; ``""`` if the action is a single array or number.
        car: wrapper of actions in physical units, if there is one.
        has_action: whether observations include the ``action`` of the game's AI.
        extras: :data:`stkzoo.mdp.spaces.EXTRAS` that the records do not contain.

    Args:
        observation_space: space of the ``full`` view.
    """

    def __init__(self, observation_space: spaces.Dict) -> None:
        self.parts = {name: name for name in observation_space.spaces}
        self.ones: dict[str, int] = {}
        self.sizes: dict[str, int] = {}
        self.is_polar = False
        self.uses: npt.NDArray[np.bool_] | None = None
        self.observer: RowObserver | None = None
        actions = kart_action_space()
        self.leaves: dict[str, Leaf] = {
            key: (_entry(actions[key], column),) for column, key in enumerate(CONTROLS)
        }
        self.car: ControlWrapper | None = None
        self.has_action = "action" in observation_space.spaces
        self.extras = extras_of(observation_space) - {"motion"}

    @property
    def is_flat(self) -> bool:
        """Whether entries are joined into vectors."""
        return [*self.parts] != [*self.parts.values()]

    def is_full(self, extras: Collection[str] = ()) -> bool:
        """Returns whether observations are those of the ``full`` view with these extras only."""
        changed = self.sizes or self.is_polar or self.is_flat or self.observer
        return not (changed or self.has_action) and self.extras == set(extras)

    @property
    def has_rows(self) -> bool:
        """Whether observations have a fixed size, so that they can be rows of a batch."""
        return self.observer is not None or bool(self.sizes)

    @property
    def has_choices(self) -> bool:
        """Whether an action is a vector of discrete choices with one entry each."""
        return set(self.leaves) == {""} and all(entry[2] for entry in self.leaves[""])

    def number_choices(self, choices: npt.NDArray[np.int64]) -> None:
        """Replaces the vector of choices by a single number.

        Args:
            choices: ``(n, m)`` int64, the vector of choices for each number.
        """
        table = np.zeros((len(choices), len(CONTROLS)), np.float32)
        for entry, values in zip(self.leaves[""], choices.T, strict=True):
            low, high, _, column, controls = entry
            if controls is None:
                table[:, column] += values
            else:
                rows = np.reshape(controls, (int(high - low) + 1, -1))
                table[:, column : column + rows.shape[1]] += rows[values - int(low)]
        self.leaves = {"": ((0.0, len(choices) - 1.0, True, 0, table),)}

    def identity(self) -> Hashable:
        """Key that is equal for equivalent plans."""
        seen: list[Any] = [tuple(e.items()) for e in (self.parts, self.ones, self.sizes)]
        mask = None if self.uses is None else self.uses.tobytes()
        leaves = tuple((key, tuple(map(_hashable, leaf))) for key, leaf in self.leaves.items())
        car = None if self.car is None else self.car.identity()
        return (*seen, self.is_polar, mask, type(self.observer), leaves, self.extras, car)

    def new_reader(self) -> ActionReader:
        """Returns the object that converts actions to controls."""
        names = () if set(self.leaves) == {""} else tuple(self.leaves)
        return ActionReader(names, tuple(self.leaves.values()))

    def new_controller(self) -> CarController | None:
        """Returns the converter from actions in physical units to controls, if there is one."""
        return None if self.car is None else self.car.car_action.new_controller()

    def new_observer(self) -> KartObserver:
        """Returns the object that makes observations from the game's records only."""
        parts = [(name, part) for name, part in self.parts.items() if not is_extra(name)]
        return KartObserver(
            tuple((name, part, self.ones.get(name, 0)) for name, part in parts),
            **self.sizes,
            polar=self.is_polar,
            uses=self.uses,
        )


def is_extra(name: str) -> bool:
    """Returns whether an entry of observations is not in the game's records."""
    return name in ("action", "standing") or name.startswith("ground_")


def _entry(part: Any, column: int) -> Entry:
    if isinstance(part, spaces.Discrete):
        return float(part.start), float(part.start + part.n - 1), True, column, None
    return float(part.low[0]), float(part.high[0]), False, column, None


def _hashable(entry: Entry) -> Hashable:
    *rest, table = entry
    return (*rest, None if table is None else table.tobytes())


# ---------------------------------------------------------------------- batches


def form_of(space: spaces.Space[Any]) -> Any:
    """Returns a batch with one row in the form of a space's values, for ``new_batch``.

    Args:
        space: a space whose values have a fixed size.
    """
    if isinstance(space, spaces.Dict):
        return {key: form_of(part) for key, part in space.spaces.items()}
    if isinstance(space, spaces.Text):
        return [""]
    return np.empty((1, *(space.shape or ())), space.dtype)


def write_rows(batch: Any, rows: IntArray, values: Any) -> None:
    """Writes values into rows of a batch.

    Args:
        batch: the batch.
        rows: rows to write.
        values: a batch with as many rows, or one value for all of them.
    """
    if isinstance(batch, dict):
        for key, value in values.items():
            write_rows(batch[key], rows, value)
    elif isinstance(batch, list):
        for place, row in enumerate(rows.tolist()):
            batch[row] = values if isinstance(values, str) else values[place]
    else:
        batch[rows] = values
