"""Evaluates the policies of a run in a separate process while the run continues."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ..rate import EVALUATIONS


class BackgroundEvaluation:
    """Evaluates saved policies one after another with :mod:`stkzoo.agents.training.rate`.

    Args:
        run: folder of the run.
        tracks: tracks of the races.
        races: races per policy.

    Attributes:
        failures: number of failed evaluations.
    """

    def __init__(self, run: Path, tracks: Sequence[str], races: int) -> None:
        self._run, self._tracks, self._races = run, tuple(tracks), races
        self._started: set[str] = set()
        self._process: subprocess.Popen[bytes] | None = None
        self.failures = 0

    def poll(self, names: Sequence[str], wait: float = 0.0) -> bool:
        """Starts the next evaluation if none is running.

        Args:
            names: policies to evaluate; each is evaluated once.
            wait: maximum time to wait for the current evaluation [s].

        Returns:
            Whether an evaluation has finished since the last call.
        """
        is_finished = False
        if self._process is not None:
            try:
                code = self._process.wait(wait)
            except subprocess.TimeoutExpired:
                return False
            self._process = None
            self.failures += code != 0
            is_finished = code == 0
        done = self._started | {path.stem for path in (self._run / EVALUATIONS).glob("*.json")}
        if left := [name for name in names if name not in done]:
            self._start(left[0])
        return is_finished

    @property
    def is_busy(self) -> bool:
        """Whether an evaluation is running."""
        return self._process is not None

    def close(self) -> None:
        """Stops the current evaluation."""
        if self._process is not None:
            self._process.terminate()
            self._process.wait()

    def _start(self, name: str) -> None:
        self._started.add(name)
        words = ["-m", "stkzoo.agents.training.rate", str(self._run), "--policy", name]
        words += ["--matches", str(self._races), "--track", *self._tracks]
        self._process = subprocess.Popen(  # noqa: S603 - this program
            [sys.executable, *words], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
        )
