"""Data for the page, passed from the race's thread to the server's thread."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from operator import itemgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.race.web.messages import encoded

#: Columns of the charts. ``speed`` is in m/s. ``gap`` is the distance behind the leader [m].
#: ``reward`` is the sum since the start. ``throttle`` is the acceleration, 0 to 1, or -1 while the
#: kart brakes.
COLUMNS = ("speed", "rank", "gap", "reward", "steer", "throttle")

FloatArray = npt.NDArray[np.float32]
#: Returns the text of a message; see :func:`text_of`.
Text = Callable[[], str]


class TraceLog:
    """History of a race for the charts, in bounded memory. One thread adds, others read.

    When the log is full, it drops every second entry and halves the rate of further entries.

    Args:
        most: maximum number of entries.
    """

    def __init__(self, most: int = 3000) -> None:
        self._most, self._stride = most, 1
        self._log: list[tuple[int, FloatArray]] = []

    def add(self, step: int, row: FloatArray) -> None:
        """Adds a step.

        Args:
            step: number of the step.
            row: ``(C, K)`` float32, values of all karts, in the order of :data:`COLUMNS`.
        """
        if step % self._stride:
            return
        self._log.append((step, row))
        if len(self._log) > self._most:
            self._stride *= 2
            self._log = [entry for entry in self._log if entry[0] % self._stride == 0]

    def since(self, step: int) -> dict[str, Any]:
        """Returns the entries after a step as JSON values.

        Returns:
            A dict with ``steps``, a list of numbers, and, unless it is empty, ``values``, a dict
                from column to a list over steps and karts.
        """
        log = self._log  # the race's thread may replace the list meanwhile
        entries = log[bisect_right(log, step, key=itemgetter(0)) :]
        if not entries:
            return {"steps": []}
        steps, rows = zip(*entries, strict=True)
        values = np.nan_to_num(np.stack(rows, axis=1).astype(np.float64)).round(3)
        columns = dict(zip(COLUMNS, values.tolist(), strict=True))
        return {"steps": list(steps), "values": columns}


@dataclass(frozen=True, slots=True)
class RaceNews:
    """Everything that the page shows. The race's thread replaces the object as a whole.

    Attributes:
        race: message with the race's constants; ``None`` before the race.
        agents: ids of the race's agents.
        traces: history of the race.
        moment: message with the current state; ``None`` before the race.
        steps: number of environment steps at this state.
        details: values of each agent at this state, for the page's tree.
        result: message with the race's result; ``None`` until the race has ended.
    """

    race: Text | None = None
    agents: tuple[str, ...] = ()
    traces: TraceLog = field(default_factory=TraceLog)
    moment: Text | None = None
    steps: int = 0
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    result: Text | None = None


def text_of(make_message: Callable[[], Mapping[str, Any]]) -> Text:
    """Returns a function that encodes a message on its first call and caches the text.

    All viewers share the text. Without viewers, the message is never created.
    """
    return cache(lambda: encoded(make_message()))
