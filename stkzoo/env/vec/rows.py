"""The results of one step of all slots: observations, rewards, ends and infos as rows of arrays."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo._checks import shortened
from stkzoo.env.episode import EndArrays, InfoTable
from stkzoo.errors import ConfigError
from stkzoo.kernel import new_batch
from stkzoo.views.plan import write_rows

BoolArray = npt.NDArray[np.bool_]

#: Gymnasium's ``VectorEnv._add_info``, which adds the info of a slot to its form.
AddInfo = Callable[[dict[str, Any], dict[str, Any], int], dict[str, Any]]


class SlotSteps:
    """One step of ``S`` slots. At first, all slots are idle, and observations have no content.

    Args:
        form: form of the observations (:func:`~stkzoo.views.plan.form_of`).
        count: number of slots.

    Attributes:
        observations: next observation of each slot: after the end of a race, the first observation
            of the next one; for an idle slot, zeros. A batch (:mod:`stkzoo.views.plan`).
        infos: info of each slot, for the same moment as its observation; empty for idle slots.
        rewards: ``(S,)`` float64, 0 for idle slots.
        terminations: ``(S,)`` bool, whether the slot's agent finished in this step.
        truncations: ``(S,)`` bool, whether the slot's agent was truncated in this step.
        ends: rewards, terminations and truncations.
        active: ``(S,)`` bool, whether the slot's agent acted in this step.
        crashed: ``(S,)`` bool, whether the slot's game crashed in this step.
        tracks: ``(S,)`` number of each slot's track, for the same moment as its observation.
        finals: last observation and info of the slots that ended in this step, by slot.
    """

    def __init__(self, form: Any, count: int) -> None:
        self.observations: Any = new_batch(form, count)
        self.infos = SlotInfos(count)
        self.rewards = np.zeros(count)
        flags: BoolArray = np.zeros((4, count), np.bool_)
        self.terminations, self.truncations, self.active, self.crashed = flags
        self.ends: EndArrays = self.rewards, self.terminations, self.truncations
        self.tracks = np.zeros(count, np.int64)
        self.finals: dict[int, tuple[Any, dict[str, Any]]] = {}

    def show(self, slot: int, observation: Any, info: dict[str, Any]) -> None:
        """Writes an observation and an info for a slot.

        Raises:
            ConfigError: the observation, which a wrapper returned, is not in its space.
        """
        try:
            write_rows(self.observations, np.array([slot]), observation)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            raise ConfigError(
                f"the observation of slot {slot} is {shortened(observation)}, which is not in its "
                "space; correct the wrapper that returned it"
            ) from error
        self.infos.set(slot, info)

    def complete(self, idle: npt.NDArray[np.intp], observation: Any) -> None:
        """Writes the observation of idle slots, which completes the observations."""
        if len(idle):
            write_rows(self.observations, idle, observation)
        self.observations = _with_tuples(self.observations)


class SlotInfos:
    """Infos of all slots.

    The kernel writes infos into tables: one, or several if races have different keys. The infos of
    races that have just started, and those from wrappers in Python, are dicts.

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
        """Sets the info of a slot."""
        self._dicts[slot] = info

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


def _with_tuples(batch: Any) -> Any:
    """Returns a batch with tuples of texts, as Gymnasium stacks them."""
    if isinstance(batch, dict):
        return {key: _with_tuples(part) for key, part in batch.items()}
    return tuple(batch) if isinstance(batch, list) else batch


def shared_space(by_agent: Mapping[str, spaces.Space[Any]], purpose: str) -> spaces.Space[Any]:
    """Returns the space that all agents share, whose values stack into one array.

    Args:
        by_agent: each agent's space.
        purpose: ``"observation"`` or ``"action"``.

    Raises:
        ConfigError: the spaces differ, or their values differ in size.
    """
    first, *others = by_agent.values()
    if any(space != first for space in others):
        raise ConfigError(
            f"the agents differ in their {purpose} spaces; give all agents the same view, and "
            "use_ai to all of them or to none"
        )
    if not is_of_fixed_size(first):
        raise ConfigError(
            f"the {purpose} space is a {type(first).__name__} whose values differ in size; choose "
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
