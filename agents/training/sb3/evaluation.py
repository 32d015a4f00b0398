"""Evaluates kept policies of a run in a process beside the training."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from ..rate import EVALUATIONS


class BackgroundEvaluation:
    """Evaluates kept policies one after another with :mod:`stkzoo.agents.training.rate`.

    Args:
        run: the run's folder.
        tracks: tracks of the races.
        races: races per policy.

    Attributes:
        failures: how many evaluations failed.
    """

    def __init__(self, run: Path, tracks: Sequence[str], races: int) -> None:
        self._run, self._tracks, self._races = run, tuple(tracks), races
        self._waiting: deque[str] = deque()
        self._process: subprocess.Popen[bytes] | None = None
        self.failures = 0

    def add(self, name: str) -> None:
        """Adds a policy to the queue, unless it has been evaluated."""
        is_done = (self._run / EVALUATIONS / f"{name}.json").exists()
        if not is_done and name not in self._waiting:
            self._waiting.append(name)

    def poll(self) -> bool:
        """Continues with the queue; whether an evaluation has finished since the last call."""
        is_finished = False
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return False
            self._process = None
            self.failures += code != 0
            is_finished = code == 0
        if self._waiting:
            self._start(self._waiting.popleft())
        return is_finished

    def wait(self, seconds: float) -> bool:
        """Waits for the present evaluation, at most this long; see :meth:`poll`."""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(seconds)
        return self.poll()

    @property
    def is_busy(self) -> bool:
        """Whether something is evaluated or waits for it."""
        return self._process is not None or bool(self._waiting)

    def close(self) -> None:
        """Ends the present evaluation and empties the queue."""
        self._waiting.clear()
        if self._process is not None:
            self._process.terminate()
            self._process.wait()
            self._process = None

    def _start(self, name: str) -> None:
        words = ["-m", "stkzoo.agents.training.rate", str(self._run), "--policy", name]
        words += ["--matches", str(self._races), "--tracks", *self._tracks]
        self._process = subprocess.Popen(  # noqa: S603 - this program
            [sys.executable, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
