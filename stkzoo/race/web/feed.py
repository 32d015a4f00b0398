"""What the page shows now, handed from the race's thread to the server's."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.race.web.messages import encoded, plain

#: ``gap`` is the distance behind the leader [m]; ``throttle`` is the acceleration, 0 to 1, or -1
#: while the kart brakes; ``reward`` is the sum since the start.
COLUMNS = ("speed", "rank", "gap", "reward", "steer", "throttle")

FloatArray = npt.NDArray[np.float32]
_Message = Mapping[str, Any]


class TraceLog:
    """The past of a race in bounded memory, for the charts. One thread adds, others read.

    A full log drops every second entry, and from then on keeps every second step.

    Args:
        most: how many steps it holds.
    """

    def __init__(self, most: int = 3000) -> None:
        self._lock = threading.Lock()
        self._most, self._stride = most, 1
        self._steps: list[int] = []
        self._rows: list[FloatArray] = []

    def add(self, step: int, row: FloatArray) -> None:
        """Adds a step.

        Args:
            step: its number.
            row: ``(C, K)`` float32, in the order of :data:`COLUMNS`.
        """
        if step % self._stride:
            return
        with self._lock:
            self._steps.append(step)
            self._rows.append(row)
            if len(self._steps) > self._most:
                self._stride *= 2
                kept = [n for n, known in enumerate(self._steps) if known % self._stride == 0]
                self._steps = [self._steps[n] for n in kept]
                self._rows = [self._rows[n] for n in kept]

    def since(self, step: int) -> dict[str, Any]:
        """The steps after one, for JSON; ``steps`` is empty if there are none."""
        with self._lock:
            first = int(np.searchsorted(self._steps, step, side="right"))
            steps, rows = self._steps[first:], self._rows[first:]
        if not rows:
            return {"steps": []}
        values = np.nan_to_num(np.stack(rows, axis=1).astype(np.float64)).round(3)
        columns = dict(zip(COLUMNS, values.tolist(), strict=True))
        return {"steps": steps, "values": columns}


@dataclass
class ViewerState:
    """What one viewer has received.

    Attributes:
        race: number of the race.
        moment: number of the moment.
        control: text of the last ``state`` message.
        step: the last step of the traces.
        has_result: whether it has the result.
        watched: the agent whose observations it wants; ``None`` for none.
        observed: agent and number of the moment of the last observation.
    """

    race: int = 0
    moment: int = 0
    control: str = ""
    step: int = -1
    has_result: bool = False
    watched: str | None = None
    observed: tuple[str | None, int] = field(default=(None, 0))


@dataclass(frozen=True, slots=True)
class _Present:
    """All that there is to show; replaced as a whole."""

    race: int = 0
    race_text: str = ""
    agents: tuple[str, ...] = ()
    traces: TraceLog = field(default_factory=TraceLog)
    moment: int = 0
    make_moment: Callable[[], _Message] | None = None
    steps: int = 0
    details: Mapping[str, _Message] = field(default_factory=dict)
    control_text: str = ""
    result_text: str = ""


class RaceFeed:
    """The current messages of a race. The race's thread writes, the server's thread reads.

    The writer hands over references and goes on. The reader makes the texts, once for all
    viewers, and only of moments that it sends.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()  # of writers: viewers set the state in the server's thread
        self._present = _Present()
        self._moment_text = (0, "")  # of the reader

    @property
    def agents(self) -> tuple[str, ...]:
        """Ids of the race's agents."""
        return self._present.agents

    @property
    def traces(self) -> TraceLog:
        """The race's past, to add to."""
        return self._present.traces

    def set_race(self, message: _Message) -> None:
        """Begins a new race."""
        agents = tuple(kart["agent"] for kart in message["karts"] if kart["agent"] is not None)
        with self._lock:
            self._present = _Present(
                race=self._present.race + 1,
                race_text=encoded(message),
                agents=agents,
                moment=self._present.moment,
                control_text=self._present.control_text,
            )

    def set_moment(
        self, steps: int, make_message: Callable[[], _Message], details: Mapping[str, _Message]
    ) -> None:
        """Sets the moment to show.

        Args:
            steps: environment steps so far.
            make_message: makes the moment's message.
            details: values of each agent for the page's tree.
        """
        number = self._present.moment + 1
        self._set(moment=number, steps=steps, make_moment=make_message, details=details)

    def set_state(self, make_message: Callable[[], _Message]) -> None:
        """Sets the state of the controls, from any thread; the last call wins."""
        with self._lock:
            self._present = replace(self._present, control_text=encoded(make_message()))

    def set_result(self, message: _Message) -> None:
        """Sets the race's result."""
        self._set(result_text=encoded(message))

    def _set(self, **changes: Any) -> None:
        with self._lock:
            self._present = replace(self._present, **changes)

    # ------------------------------------------------------------------ the reader

    def news(self, viewer: ViewerState, *, with_observation: bool) -> list[str]:
        """The texts that a viewer does not have yet; marks them as sent."""
        now, texts = self._present, []
        if viewer.race != now.race:
            viewer.race, viewer.step, viewer.has_result = now.race, -1, False
            viewer.observed = (None, 0)
            texts.append(now.race_text)
        if viewer.control != now.control_text:
            viewer.control = now.control_text
            texts.append(viewer.control)
        if now.make_moment is not None and viewer.moment != now.moment:
            viewer.moment = now.moment
            past = now.traces.since(viewer.step)
            if past["steps"]:
                viewer.step = past["steps"][-1]
                texts.append(encoded({"type": "traces", **past}))
            if self._moment_text[0] != now.moment:
                self._moment_text = (now.moment, encoded(now.make_moment()))
            texts.append(self._moment_text[1])
        if with_observation and self.owes_observation(viewer, now):
            viewer.observed = (viewer.watched, now.moment)
            parts = plain(now.details[str(viewer.watched)])
            message = {"agent": viewer.watched, "steps": now.steps, "parts": parts}
            texts.append(encoded({"type": "observation", **message}))
        if now.result_text and not viewer.has_result:
            viewer.has_result = True
            texts.append(now.result_text)
        return texts

    def owes_observation(self, viewer: ViewerState, now: _Present | None = None) -> bool:
        """Whether a viewer lacks the last observation of the agent that it watches."""
        now = now or self._present
        is_new = viewer.observed != (viewer.watched, now.moment)
        return viewer.watched in now.details and is_new
