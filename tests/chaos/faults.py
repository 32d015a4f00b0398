"""One fault: whom it hits, how and when; and a seeded source of them."""

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

#: What a fault does to a process, and how often it is drawn. ``PAUSE`` stops a process and
#: lets it go on a second later, which must change nothing.
SIGNALS = {"SIGKILL": 5, "SIGSEGV": 4, "SIGSTOP": 2, "SIGABRT": 1, "SIGTERM": 1, "PAUSE": 1}
#: The same for a program that is hit from outside.
TO_PROGRAM = {"SIGKILL": 3, "SIGINT": 3, "SIGTERM": 2, "PAUSE": 1}
#: Moments of a program that is hit from outside: any.
OUTSIDE = ("run",)
_PAUSE = 1.0  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault.

    Attributes:
        form: which form of the environment, or which program, it happens in.
        moment: what the form does meanwhile.
        target: kind of process that it hits (:mod:`tests.chaos.family`).
        signal: what it does to the process, one of :data:`SIGNALS`.
        share: when, as a share of the time that the moment takes.
        choice: which process of the kind, as a share of their number.
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
    """A fault of a form, drawn from a seeded source."""
    moment, target = chance.choice(moments), chance.choice(targets)
    if moment == "construct" and target == "race":
        target = "fork server"  # there is no race yet
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
        return "SIGINT"  # which it lives on after
    kinds = TO_PROGRAM if target == "program" else SIGNALS
    drawn = chance.choices(list(kinds), list(kinds.values()))[0]
    # Programs wait as long as they do by default, which is a minute.
    return "PAUSE" if is_outside and drawn == "SIGSTOP" and target != "agent" else drawn


class Strike:
    """Does to a process of a program what a fault says.

    Args:
        fault: the fault.
        program: process id of the program whose family is hit.
        spared: processes that are not hit.

    Attributes:
        pid: who was hit; ``None`` if there was nobody.
    """

    def __init__(self, fault: Fault, program: int, spared: Collection[int] = ()) -> None:
        self._fault, self._program, self._spared = fault, program, spared
        self.pid: int | None = None

    def now(self) -> None:
        """Hits."""
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
        """Hits from a thread beside, in the midst of something that takes so many seconds."""
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
