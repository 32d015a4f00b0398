"""The results of one step of all slots: observations, rewards, ends and infos as rows of arrays."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.wrappers.utils import create_zero_array

from stkzoo.env.episode import WHOLE_INFOS, EndArrays, InfoTable
from stkzoo.errors import ConfigError
from stkzoo.kernel import new_batch
from stkzoo.views.plan import form_of, write_rows

BoolArray = npt.NDArray[np.bool_]

#: Gymnasium's ``VectorEnv._add_info``, which adds the info of a slot to its form.
AddInfo = Callable[[dict[str, Any], dict[str, Any], int], dict[str, Any]]


@dataclass(slots=True)
class SlotSteps:
    """One step of ``S`` slots.

    Attributes:
        observations: next observation of each slot: after the end of a race, the first observation
            of the next one; for an idle slot, zeros. A batch (:mod:`stkzoo.views.plan`).
        infos: info of each slot, for the same moment as its observation; empty for idle slots.
        rewards: ``(S,)`` float64, 0 for idle slots.
        terminations: ``(S,)`` bool, whether the slot's agent finished in this step.
        truncations: ``(S,)`` bool, whether the slot's agent was truncated in this step.
        active: ``(S,)`` bool, whether the slot's agent acted in this step.
        crashed: ``(S,)`` bool, whether the slot's game crashed in this step.
        tracks: ``(S,)`` number of each slot's track, for the same moment as its observation.
        finals: last observation and info of the slots that ended in this step, by slot.
    """

    observations: Any
    infos: SlotInfos
    rewards: npt.NDArray[np.float64]
    terminations: BoolArray
    truncations: BoolArray
    active: BoolArray
    crashed: BoolArray
    tracks: npt.NDArray[np.int64]
    finals: dict[int, tuple[Any, dict[str, Any]]] = field(default_factory=dict)

    @property
    def ends(self) -> EndArrays:
        """Rewards, terminations and truncations."""
        return self.rewards, self.terminations, self.truncations

    def show(self, slot: int, observation: Any, info: dict[str, Any]) -> None:
        """Writes an observation and an info for a slot."""
        write_rows(self.observations, np.array([slot]), observation)
        self.infos.set(slot, info)


class SlotInfos:
    """Infos of all slots.

    The kernel writes infos into tables: one, or several if races have different keys. Infos from
    wrappers in Python with other values than plain numbers are dicts.

    Args:
        count: number of slots.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._tables: dict[tuple[str, ...], InfoTable] = {}
        self._dicts: dict[int, dict[str, Any]] = {}

    def table(self, keys: tuple[str, ...]) -> InfoTable:
        """Returns the table with some keys, in order."""
        if keys not in self._tables:
            self._tables[keys] = InfoTable(keys, self._count)
        return self._tables[keys]

    def set(self, slot: int, info: dict[str, Any]) -> None:
        """Sets the info of a slot; in a table if it has plain numbers, as the kernel writes."""
        others = {key: value for key, value in info.items() if type(value) is not float}
        if (*others,) != WHOLE_INFOS or any(type(value) is not int for value in others.values()):
            self._dicts[slot] = info
            return
        table = self.table((*info,))
        for key, column in table.columns.items():
            column[slot] = info[key]
        table.has[slot] = True

    def columns(self, add: AddInfo) -> dict[str, npt.NDArray[Any]]:
        """Returns an array of values and a mask for each key, in Gymnasium's form.

        Args:
            add: adds the info of a slot to infos in this form.
        """
        columns: dict[str, npt.NDArray[Any]] = {}
        for table in self._tables.values():
            masks = np.tile(table.has, (len(table.columns), 1))
            for (key, values), mask in zip(table.columns.items(), masks, strict=True):
                if key in columns:  # other slots have it in another table, and 0 in this one
                    values, mask = values + columns[key], mask | columns[f"_{key}"]
                columns[key], columns[f"_{key}"] = values, mask
        for slot, info in sorted(self._dicts.items()):
            columns = add(columns, dict(info), slot)
        return columns

    def keys_of(self, slot: int) -> Collection[str]:
        """Returns the keys of a slot's info; none if it is idle."""
        return tuple(self._values_of(slot))

    def value(self, slot: int, key: str) -> Any:
        """Returns one value of a slot's info; raises ``KeyError`` if there is none."""
        value = self._values_of(slot)[key]
        return value if slot in self._dicts else value[slot].item()

    def _values_of(self, slot: int) -> Mapping[str, Any]:
        """Returns a slot's info, or the columns of the table that has it."""
        if slot in self._dicts:
            return self._dicts[slot]
        return next((table.columns for table in self._tables.values() if table.has[slot]), {})


class SlotRows:
    """Makes the steps of all slots.

    Args:
        space: observation space of one slot, whose values have a fixed size.
        count: number of slots.

    Attributes:
        idle: observation of an idle slot.
    """

    def __init__(self, space: spaces.Space[Any], count: int) -> None:
        self.idle = create_zero_array(space)
        self._form, self._count = form_of(space), count

    def new(self) -> SlotSteps:
        """Returns a step in which all slots are idle, with observations without content."""
        count = self._count
        terminations, truncations, active, crashed = np.zeros((4, count), np.bool_)
        return SlotSteps(
            observations=new_batch(self._form, count),
            infos=SlotInfos(count),
            rewards=np.zeros(count),
            terminations=terminations,
            truncations=truncations,
            active=active,
            crashed=crashed,
            tracks=np.zeros(count, np.int64),
        )

    def complete(self, steps: SlotSteps, idle: npt.NDArray[np.intp]) -> None:
        """Writes the observations of idle slots, which completes the observations."""
        if len(idle):
            write_rows(steps.observations, idle, self.idle)
        steps.observations = _with_tuples(steps.observations)


def _with_tuples(batch: Any) -> Any:
    """Returns a batch with tuples of texts, as Gymnasium stacks them."""
    if isinstance(batch, dict):
        return {key: _with_tuples(part) for key, part in batch.items()}
    return tuple(batch) if isinstance(batch, list) else batch


def shared_space(by_agent: Mapping[str, spaces.Space[Any]], kind: str) -> spaces.Space[Any]:
    """Returns the space that all agents share, whose values stack into one array.

    Args:
        by_agent: each agent's space.
        kind: ``"observation"`` or ``"action"``.

    Raises:
        ConfigError: the spaces differ, or their values differ in size.
    """
    first, *others = by_agent.values()
    if any(space != first for space in others):
        raise ConfigError(
            f"the agents differ in their {kind} spaces: {dict(by_agent)}; give all "
            "agents the same view, and use_ai to all of them or to none"
        )
    if not is_of_fixed_size(first):
        raise ConfigError(
            f"the {kind} space is a {type(first).__name__} whose values differ in size; choose "
            'view="simple", one of the flattened views, or your own view with Box, Discrete, '
            "MultiDiscrete, MultiBinary, Text and Dict spaces"
        )
    return first


def is_of_fixed_size(space: spaces.Space[Any]) -> bool:
    """Whether all values of a space have the same size, so that they stack into one array."""
    if isinstance(space, spaces.Dict):
        return all(map(is_of_fixed_size, space.spaces.values()))
    kinds = spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary, spaces.Text
    return isinstance(space, kinds)
