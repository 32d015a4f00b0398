"""Controls of the live page: run, pause, step, stop and speed."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

from stkzoo._checks import shortened
from stkzoo.errors import ConfigError

#: Available speeds, as multiples of real time; ``None`` for no limit.
SPEEDS: tuple[float | None, ...] = (1.0, 2.0, 4.0, None)

#: Maximum duration of a single wait [s]. Waits are short so that Ctrl-C works on every system.
_WAKE_UP = 0.5
#: Maximum delay that a race catches up [s].
_MOST_LATE = 0.25


class RaceControl:
    """Controls when a race takes its next step.

    The race's thread calls :meth:`begin`, :meth:`wait_turn`, :meth:`finish` and
    :meth:`wait_stop`. Other threads may call the remaining methods.

    Args:
        speed: one of :data:`SPEEDS`.
        paused: whether the race is paused before its first step.

    Raises:
        ConfigError: the speed is invalid.
    """

    def __init__(self, speed: float | None = 1.0, *, paused: bool = False) -> None:
        self._changed = threading.Condition()
        self._speed = _checked(speed)
        self._paused, self._stopped, self._over = paused, False, False
        self._steps = 0
        self._last = time.monotonic()

    @property
    def mode(self) -> str:
        """``"running"``, ``"paused"``, ``"stopping"`` or ``"over"``."""
        if self._over:
            return "over"
        if self._stopped:
            return "stopping"
        return "paused" if self._paused else "running"

    @property
    def state(self) -> dict[str, Any]:
        """State that the page shows: ``mode`` and ``speed``."""
        return {"mode": self.mode, "speed": self._speed}

    def run(self) -> None:
        """Starts or resumes the race."""
        self._set(_paused=False, _steps=0, _last=time.monotonic())

    def pause(self) -> None:
        """Pauses the race before its next step."""
        self._set(_paused=True, _steps=0)

    def step(self) -> None:
        """Runs one step of a paused race; pauses a running race."""
        self._set(_steps=self._steps + 1 if self._paused else 0, _paused=True)

    def stop(self) -> None:
        """Ends the race after the current step."""
        self._set(_stopped=True)

    def set_speed(self, speed: float | None) -> None:
        """Sets the speed.

        Raises:
            ConfigError: the speed is not in :data:`SPEEDS`.
        """
        self._set(_speed=_checked(speed), _last=time.monotonic())

    def begin(self) -> None:
        """Begins a race. A :meth:`stop` that was called before it stays in effect."""
        with self._changed:
            is_stopped = self._stopped and not self._over
            self._set(_over=False, _stopped=is_stopped, _last=time.monotonic())

    def finish(self) -> None:
        """Ends the race."""
        self._set(_over=True, _stopped=False)

    def wait_turn(self, step_size: float) -> bool:
        """Waits until the race may take its next step.

        Args:
            step_size: game time of a step [s].

        Returns:
            Whether the race continues; ``False`` after :meth:`stop`.
        """
        with self._changed:
            while not self._stopped and (seconds := self._time_left(step_size)):
                self._changed.wait(min(seconds, _WAKE_UP))
            return not self._stopped

    def wait_stop(self) -> None:
        """Waits until :meth:`stop` is called, also after the race."""
        with self._changed:
            while not self._stopped:
                self._changed.wait(_WAKE_UP)

    def _time_left(self, step_size: float) -> float:
        """Returns the time until the race may take its next step [s]; if it is 0, it takes it."""
        now = time.monotonic()
        if self._paused and not self._steps:
            return math.inf
        due = now
        if self._speed is not None and not self._paused:
            due = self._last + step_size / self._speed
        if now < due:
            return due - now
        self._steps = max(self._steps - 1, 0)
        self._last = due if now - due < _MOST_LATE else now
        return 0.0

    def _set(self, **changes: Any) -> None:
        with self._changed:
            for name, value in changes.items():
                setattr(self, name, value)
            self._changed.notify_all()


def _checked(speed: object) -> float | None:
    for known in SPEEDS:
        if speed == known and not isinstance(speed, bool):
            return known
    raise ConfigError(f"the speed is {shortened(speed, 50)}, expected 1, 2, 4 or None (no limit)")
