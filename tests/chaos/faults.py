"""Faults: the process, the signal and the time, drawn from a seeded source."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

from tests.chaos.family import family

__all__ = ["OUTSIDE", "SIGNALS", "Fault", "Strike", "draw_fault"]

#: Signals and their weights. ``PAUSE`` stops a process and continues it one second later, which
#: must not change anything.
SIGNALS = {"SIGKILL": 5, "SIGSEGV": 4, "SIGSTOP": 2, "SIGABRT": 1, "SIGTERM": 1, "PAUSE": 1}
#: The same for signals to a whole program.
TO_PROGRAM = {"SIGKILL": 3, "SIGINT": 3, "SIGTERM": 2, "PAUSE": 1}
#: The moments of faults that hit a program from outside: at any time.
OUTSIDE = ("run",)
_PAUSE = 1.0  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault.

    Attributes:
        form: form of the environment, or program, in which the fault occurs.
        moment: what the form does at that time.
        target: role of the process to hit (:mod:`tests.chaos.family`).
        signal: one of :data:`SIGNALS`.
        share: time of the fault, as a fraction of the moment's duration.
        choice: which process with that role, as a fraction of their number.
    """

    form: str
    moment: str
    target: str
    signal: str
    share: float
    choice: float


def draw_fault(
    chance: random.Random, form: str, moments: Sequence[str], targets: Sequence[str]
) -> Fault:
    """Draws a fault of a form from a seeded source."""
    moment, target = chance.choice(moments), chance.choice(targets)
    if moment == "construct" and target == "race":
        target = "fork server"  # there is no race process yet
    return Fault(
        form=form,
        moment=moment,
        target=target,
        signal=_draw_signal(chance, target, is_outside=moments == OUTSIDE),
        share=chance.random(),
        choice=chance.random(),
    )


def _draw_signal(chance: random.Random, target: str, *, is_outside: bool) -> str:
    if target == "program" and not is_outside:
        return "SIGINT"  # other signals would end the test run
    kinds = TO_PROGRAM if target == "program" else SIGNALS
    drawn = chance.choices(list(kinds), list(kinds.values()))[0]
    # Programs use the default timeout of a minute, so SIGSTOP would take too long.
    return "PAUSE" if is_outside and drawn == "SIGSTOP" and target != "agent" else drawn


class Strike:
    """Applies a fault to a process of a program.

    Args:
        fault: the fault.
        program: process id of the program.
        spared: processes that must not be hit.

    Attributes:
        pid: process that was hit; ``None`` if there was none.
    """

    def __init__(self, fault: Fault, program: int, spared: Collection[int] = ()) -> None:
        self._fault, self._program, self._spared = fault, program, spared
        self.pid: int | None = None

    def now(self) -> None:
        """Applies the fault."""
        fault = self._fault
        targets = self._targets()
        if not targets:
            return
        pid = sorted(targets)[int(fault.choice * len(targets))]
        with contextlib.suppress(ProcessLookupError):
            if fault.signal == "PAUSE":
                self._pause(pid)
            else:
                os.kill(pid, signal.Signals[fault.signal])
            self.pid = pid

    @contextlib.contextmanager
    def during(self, seconds: float) -> Iterator[None]:
        """Applies the fault from a thread while the body runs, which takes about ``seconds``."""
        timer = threading.Timer(seconds * self._fault.share, self.now)
        timer.start()
        try:
            yield
        finally:
            timer.join()

    def _targets(self) -> list[int]:
        if self._fault.target == "program":
            return [self._program]
        return [
            member.pid
            for member in family(self._program)
            if member.kind == self._fault.target and member.pid not in self._spared
        ]

    def _pause(self, pid: int) -> None:
        os.kill(pid, signal.SIGSTOP)
        time.sleep(_PAUSE)
        os.kill(pid, signal.SIGCONT)
