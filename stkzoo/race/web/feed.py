"""What the page shows now, handed from the race's thread to the server's."""

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

#: ``gap`` is the distance behind the leader [m]; ``throttle`` is the acceleration, 0 to 1, or -1
#: while the kart brakes; ``reward`` is the sum since the start.
COLUMNS = ("speed", "rank", "gap", "reward", "steer", "throttle")

FloatArray = npt.NDArray[np.float32]
#: Makes the text of a message; see :func:`text_of`.
Text = Callable[[], str]


class TraceLog:
    """The past of a race in bounded memory, for the charts. One thread adds, others read.

    A full log drops every second entry, and from then on keeps every second step.

    Args:
        most: how many steps it holds.
    """

    def __init__(self, most: int = 3000) -> None:
        self._most, self._stride = most, 1
        self._log: list[tuple[int, FloatArray]] = []

    def add(self, step: int, row: FloatArray) -> None:
        """Adds a step.

        Args:
            step: its number.
            row: ``(C, K)`` float32, in the order of :data:`COLUMNS`.
        """
        if step % self._stride:
            return
        self._log.append((step, row))
        if len(self._log) > self._most:
            self._stride *= 2
            self._log = [entry for entry in self._log if entry[0] % self._stride == 0]

    def since(self, step: int) -> dict[str, Any]:
        """The steps after one, for JSON; ``steps`` is empty if there are none."""
        log = self._log  # the other thread may append to it, or replace it
        entries = log[bisect_right(log, step, key=itemgetter(0)) :]
        if not entries:
            return {"steps": []}
        steps, rows = zip(*entries, strict=True)
        values = np.nan_to_num(np.stack(rows, axis=1).astype(np.float64)).round(3)
        columns = dict(zip(COLUMNS, values.tolist(), strict=True))
        return {"steps": list(steps), "values": columns}


@dataclass(frozen=True, slots=True)
class RaceNews:
    """All that there is to show of a race. The race's thread replaces it as a whole.

    Attributes:
        race: the message with the race's constants.
        agents: ids of the race's agents.
        traces: the race's past.
        moment: the message about the moment.
        steps: environment steps until then.
        details: values of each agent then, for the page's tree.
        result: the message with the race's result.
    """

    race: Text | None = None
    agents: tuple[str, ...] = ()
    traces: TraceLog = field(default_factory=TraceLog)
    moment: Text | None = None
    steps: int = 0
    details: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    result: Text | None = None


def text_of(make_message: Callable[[], Mapping[str, Any]]) -> Text:
    """The text of a message, made once for all viewers, and only if there are any."""
    return cache(lambda: encoded(make_message()))
