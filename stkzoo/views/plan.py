"""What a chain of wrappers amounts to, in the words of the kernel.

A :class:`ViewPlan` starts as the ``full`` view. Each wrapper, the innermost first, adds what it
does (``compile_into``), until one cannot say it. What the plan says then takes the place of
these wrappers: the kernel makes their observation straight from the game's records, and controls
straight from their action.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo.kernel import ActionReader, CarController, KartObserver
from stkzoo.mdp.spaces import extras_of

if TYPE_CHECKING:
    from stkzoo.wrappers.control import ControlWrapper

IntArray = npt.NDArray[np.intp]

#: Lowest and highest value of one number of an action, whether it is whole, the column of the
#: controls that it goes to, and for choices a table of what each adds to the controls.
Entry = tuple[float, float, bool, int, Any]
#: All numbers that stand under one key.
Leaf = tuple[Entry, ...]


class ObservationSource(Protocol):
    """A race at one moment, as observations are made of it."""

    @property
    def course(self) -> tuple[Any, int, tuple[str, ...]]:
        """The track's ``TrackGraph``, how many segments are seen, and the karts' models."""

    @property
    def track_map(self) -> Any:
        """The :class:`~stkzoo.engine.track.TrackMap`."""

    @property
    def snapshot(self) -> Any:
        """The moment."""

    def ground_ahead(self, karts: IntArray) -> Mapping[str, npt.NDArray[Any]]:
        """What is beside the road ahead of some karts, by entry of the observation."""

    def karts(self, agents: Sequence[str]) -> IntArray:
        """The agents' karts, ``(A,)``."""


class Observer(Protocol):
    """Makes one observation for each of some karts."""

    def observe(self, source: ObservationSource, karts: IntArray) -> list[Any]:
        """The observations, in Gymnasium's form."""


class ViewPlan:
    """What the compiled wrappers of one agent do.

    Attributes:
        names: the observation's entries; of a flat one the numbers first, then the choices.
        sizes: fixed lengths of the lists ``items``, ``karts`` and ``paths``, if they have one.
        is_polar: whether positions are angles and a distance.
        is_flat: whether the observation is two vectors.
        joined: how many values each choice has, if both vectors are one.
        nitro: which actions press nitro, if there is a mask of useful actions.
        fire: which actions fire, likewise.
        observer: makes observations in a way of its own.
        columns: of the controls.
        leaves: what the numbers of an action are, by key; under ``""`` for an action that is
            one array or number.
        car: the wrapper of an action in physical units, if the controls are made of one.
        has_action: whether observations carry the ``action`` of the game's AI.
        sees_ground: whether observations tell of the ground.

    Args:
        observation_space: of the ``full`` view.
        action_space: of the game's own actions.
        columns: the actions' keys in the order of the controls.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Dict,
        columns: Sequence[str],
    ) -> None:
        self.names = tuple(observation_space.spaces)
        self.sizes: dict[str, int] = {}
        self.is_polar = self.is_flat = False
        self.joined: tuple[int, ...] | None = None
        self.nitro: npt.NDArray[np.bool_] | None = None
        self.fire: npt.NDArray[np.bool_] | None = None
        self.observer: Observer | None = None
        self.columns = tuple(columns)
        self.leaves: dict[str, Leaf] = {
            key: (_entry(action_space[key], column),) for column, key in enumerate(columns)
        }
        self.car: ControlWrapper | None = None
        self.has_action = "action" in observation_space.spaces
        self.sees_ground = "ground" in extras_of(observation_space)

    @property
    def is_full(self) -> bool:
        """Whether observations are still those of the ``full`` view, and nothing more."""
        changed = self.sizes or self.is_polar or self.is_flat or self.observer
        return not (changed or self.has_action or self.sees_ground)

    @property
    def has_choices(self) -> bool:
        """Whether an action is one vector of choices, each with its own entry."""
        return set(self.leaves) == {""} and all(entry[2] for entry in self.leaves[""])

    def number_choices(self, choices: npt.NDArray[np.int64]) -> None:
        """Makes an action one number.

        Args:
            choices: ``(n, m)`` what each number stands for in the vector of choices.
        """
        table = np.zeros((len(choices), len(self.columns)), np.float32)
        for entry, values in zip(self.leaves[""], choices.T, strict=True):
            low, high, _, column, controls = entry
            if controls is None:
                table[:, column] += values
            else:
                rows = np.reshape(controls, (int(high - low) + 1, -1))
                table[:, column : column + rows.shape[1]] += rows[values - int(low)]
        self.leaves = {"": ((0.0, len(choices) - 1.0, True, 0, table),)}

    def identity(self) -> Hashable:
        """Equal for plans that say the same."""
        mask = (
            None if self.nitro is None else (self.nitro.tobytes(), np.asarray(self.fire).tobytes())
        )
        seen = self.names, tuple(sorted(self.sizes.items())), self.is_polar, self.is_flat
        leaves = tuple((key, tuple(map(_hashable, leaf))) for key, leaf in self.leaves.items())
        car = None if self.car is None else self.car.identity()
        return (*seen, self.joined, mask, type(self.observer), leaves, self.sees_ground, car)

    def new_reader(self) -> ActionReader:
        """What turns actions into controls."""
        names = () if set(self.leaves) == {""} else tuple(self.leaves)
        return ActionReader(names, tuple(self.leaves.values()), len(self.columns))

    def new_controller(self) -> CarController | None:
        """What turns an action in physical units into controls."""
        return None if self.car is None else self.car.car_action.new_controller(self.columns)

    def new_observer(self) -> KartObserver:
        """What makes observations from the game's records, but for the ground."""
        return KartObserver(
            tuple(name for name in self.names if not name.startswith("ground_")),
            **self.sizes,
            polar=self.is_polar,
            flat=self.is_flat,
            joined=None if self.joined is None else np.array(self.joined, np.intp),
            nitro=self.nitro,
            fire=self.fire,
        )


def _entry(part: Any, column: int) -> Entry:
    if isinstance(part, spaces.Discrete):
        return float(part.start), float(part.start + part.n - 1), True, column, None
    return float(part.low[0]), float(part.high[0]), False, column, None


def _hashable(entry: Entry) -> Hashable:
    *rest, table = entry
    return (*rest, None if table is None else table.tobytes())
