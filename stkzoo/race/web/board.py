"""What the page is to show now, between the thread that races and the one that serves."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from stkzoo.race.web.forms import encoded, plain
from stkzoo.race.web.traces import TraceLog

__all__ = ["Board", "Sight"]


@dataclass
class Sight:
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


class Board:
    """The present of a race. One thread writes, one reads.

    The writer hands over references and goes on: texts are made by the reader, once for
    all viewers, and only of moments that are really sent.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.traces = TraceLog()
        self.agents: tuple[str, ...] = ()
        self._race, self._race_text = 0, ""
        self._moment, self._moment_text = 0, ""
        self._form: Mapping[str, Any] | None = None
        self._sights: Mapping[str, Mapping[str, Any]] = {}
        self._result_text = ""
        self.state_text = ""

    def set_race(self, form: Mapping[str, Any]) -> None:
        """A new race; its moments follow."""
        text = encoded(form)
        with self._lock:
            self._race, self._race_text = self._race + 1, text
            self._form, self._moment_text, self._result_text = None, "", ""
            self._sights = {}
            self.traces.clear()
            self.agents = tuple(k["agent"] for k in form["karts"] if k["agent"] is not None)

    def set_moment(self, form: Mapping[str, Any], sights: Mapping[str, Mapping[str, Any]]) -> None:
        """The race has moved.

        Args:
            form: the moment's message.
            sights: for each agent what can be looked at in the tree.
        """
        with self._lock:
            self._moment += 1
            self._form, self._moment_text, self._sights = form, "", sights

    def set_result(self, form: Mapping[str, Any]) -> None:
        """The race is over."""
        self._result_text = encoded(form)

    def news(self, sight: Sight, *, with_observation: bool) -> list[str]:
        """The texts that a viewer lacks; marks them as sent."""
        texts = []
        with self._lock:
            if sight.race != self._race:
                sight.race, sight.step, sight.has_result = self._race, -1, False
                sight.observed = (None, 0)
                texts.append(self._race_text)
            if sight.state != self.state_text:
                sight.state = self.state_text
                texts.append(sight.state)
            if self._form is not None and sight.moment != self._moment:
                texts += self._traces_after(sight)
                self._moment_text = self._moment_text or encoded(self._form)
                texts.append(self._moment_text)
                sight.moment = self._moment
            if with_observation and self.owes_observation(sight):
                sight.observed = (sight.watched, self._moment)
                texts.append(self._observation_of(sight.watched))
            if self._result_text and not sight.has_result:
                sight.has_result = True
                texts.append(self._result_text)
        return texts

    def owes_observation(self, sight: Sight) -> bool:
        """Whether a viewer's agent has seen something that the viewer has not."""
        seen = sight.watched in self._sights
        return seen and sight.observed != (sight.watched, self._moment)

    def _traces_after(self, sight: Sight) -> list[str]:
        traces = self.traces.since(sight.step)
        if not traces["steps"]:
            return []
        sight.step = traces["steps"][-1]
        return [encoded({"type": "traces", **traces})]

    def _observation_of(self, agent: str | None) -> str:
        assert self._form is not None  # noqa: S101 - sights come with a moment
        assert agent is not None  # noqa: S101 - it is among the sights
        parts = plain(self._sights[agent])
        steps = self._form["steps"]
        return encoded({"type": "observation", "agent": agent, "steps": steps, "parts": parts})
