"""What the page shows now, handed from the race's thread to the server's."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.race.web.messages import encoded, plain

__all__ = ["COLUMNS", "RaceFeed", "TraceLog", "ViewerState"]

#: ``gap`` is the way behind the leader [m]; ``throttle`` is the acceleration, 0 to 1, or -1
#: while the kart brakes; ``reward`` is the sum since the start.
COLUMNS = ("speed", "rank", "gap", "reward", "steer", "throttle")

FloatArray = npt.NDArray[np.float32]


class TraceLog:
    """The past of a race in bounded memory. One thread adds, others read.

    Once it is full, every second entry goes, and from then on every second is kept.

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


_Form = Mapping[str, Any]


@dataclass
class ViewerState:
    """What one viewer has been sent.

    Attributes:
        race: number of the race.
        moment: number of the moment.
        state: text of the state.
        step: the last step of the traces.
        has_result: whether the result.
        watched: the agent whose observation is asked for; ``None`` is nobody.
        observed: agent and number of the moment of the last observation.
    """

    race: int = 0
    moment: int = 0
    state: str = ""
    step: int = -1
    has_result: bool = False
    watched: str | None = None
    observed: tuple[str | None, int] = field(default=(None, 0))


@dataclass(frozen=True, slots=True)
class _Present:
    """What there is to show, replaced as a whole."""

    race: int = 0
    race_text: str = ""
    agents: tuple[str, ...] = ()
    traces: TraceLog = field(default_factory=TraceLog)
    moment: int = 0
    make_moment: Callable[[], _Form] | None = None
    steps: int = 0
    sights: Mapping[str, _Form] = field(default_factory=dict)
    state_text: str = ""
    result_text: str = ""


class RaceFeed:
    """The present of a race. One thread races and writes, one serves and reads.

    The writer hands over references and goes on: texts are made by the reader, once for
    all viewers, and only of moments that are really sent.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()  # of writers: whoever steers sets the state
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

    def set_race(self, form: _Form) -> None:
        """A new race; its moments follow."""
        agents = tuple(kart["agent"] for kart in form["karts"] if kart["agent"] is not None)
        with self._lock:
            self._present = _Present(
                race=self._present.race + 1,
                race_text=encoded(form),
                agents=agents,
                moment=self._present.moment,
                state_text=self._present.state_text,
            )

    def set_moment(
        self, steps: int, make_form: Callable[[], _Form], sights: Mapping[str, _Form]
    ) -> None:
        """The race has moved.

        Args:
            steps: environment steps so far.
            make_form: makes the moment's message.
            sights: for each agent what can be looked at in the tree.
        """
        number = self._present.moment + 1
        self._set(moment=number, steps=steps, make_moment=make_form, sights=sights)

    def set_state(self, make_form: Callable[[], _Form]) -> None:
        """Somebody has steered; from any thread, of which the last tells how things stand."""
        with self._lock:
            self._present = replace(self._present, state_text=encoded(make_form()))

    def set_result(self, form: _Form) -> None:
        """The race is over."""
        self._set(result_text=encoded(form))

    def _set(self, **changes: Any) -> None:
        with self._lock:
            self._present = replace(self._present, **changes)

    # ------------------------------------------------------------------ the reader

    def news(self, sight: ViewerState, *, with_observation: bool) -> list[str]:
        """The texts that a viewer lacks; marks them as sent."""
        now, texts = self._present, []
        if sight.race != now.race:
            sight.race, sight.step, sight.has_result = now.race, -1, False
            sight.observed = (None, 0)
            texts.append(now.race_text)
        if sight.state != now.state_text:
            sight.state = now.state_text
            texts.append(sight.state)
        if now.make_moment is not None and sight.moment != now.moment:
            sight.moment = now.moment
            texts += [*_traces_after(sight, now.traces), self._text_of_moment(now)]
        if with_observation and _owes_observation(sight, now):
            sight.observed = (sight.watched, now.moment)
            texts.append(_observation_of(str(sight.watched), now))
        if now.result_text and not sight.has_result:
            sight.has_result = True
            texts.append(now.result_text)
        return texts

    def owes_observation(self, sight: ViewerState) -> bool:
        """Whether a viewer's agent has seen something that the viewer has not."""
        return _owes_observation(sight, self._present)

    def _text_of_moment(self, now: _Present) -> str:
        number, text = self._moment_text
        if number != now.moment:
            assert now.make_moment is not None  # noqa: S101 - there is a moment
            text = encoded(now.make_moment())
            self._moment_text = (now.moment, text)
        return text


def _owes_observation(sight: ViewerState, now: _Present) -> bool:
    return sight.watched in now.sights and sight.observed != (sight.watched, now.moment)


def _traces_after(sight: ViewerState, traces: TraceLog) -> list[str]:
    past = traces.since(sight.step)
    if not past["steps"]:
        return []
    sight.step = past["steps"][-1]
    return [encoded({"type": "traces", **past})]


def _observation_of(agent: str, now: _Present) -> str:
    parts = plain(now.sights[agent])
    return encoded({"type": "observation", "agent": agent, "steps": now.steps, "parts": parts})
