"""Measures how the CPU time of a learner and its races is spent."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from stkzoo._os import cpu_count

SHARES = ("engine", "observing", "networks", "learning", "rest", "waiting")
_TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


def processor_times() -> dict[int, tuple[int, float, float]]:
    """Returns the parent, the CPU time and the CPU time of ended children [s] of all processes."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            text = (entry / "stat").read_text()
        except OSError:
            continue
        fields = text[text.rindex(")") + 2 :].split()
        own, children = (sum(map(int, fields[n : n + 2])) / _TICKS for n in (11, 13))
        found[int(entry.name)] = int(fields[1]), own, children
    return found


def engine_time(programs: Sequence[int]) -> float:
    """Returns the CPU time of this program's descendants other than ``programs`` [s]."""
    times = processor_times()
    total, level = 0.0, {os.getpid()}
    while level:
        level = {pid for pid, (parent, *_) in times.items() if parent in level}
        total += sum(sum(times[pid][1:]) for pid in level.difference(programs))
    return total


class Meter:
    """Sums the CPU time of this thread in measured calls, without measured calls inside them."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._inner = 0.0

    def timed(self, name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        """Returns a function that runs ``call`` and adds its time under a name."""

        def measured(*arguments: Any, **named: Any) -> Any:
            outer, self._inner = self._inner, 0.0
            begin = time.thread_time()
            try:
                return call(*arguments, **named)
            finally:
                spent = time.thread_time() - begin
                own = self.seconds.get(name, 0.0)
                self.seconds[name] = own + spent - self._inner
                self._inner = outer + spent

        return measured


def shares_of(
    wall: float, engine: float, programs: float, parts: Mapping[str, float]
) -> dict[str, float]:
    """Returns the shares of the time of all cores.

    Args:
        wall: elapsed time [s].
        engine: CPU time of the game's processes [s].
        programs: CPU time of all other processes [s].
        parts: CPU time of parts of the other processes, by name [s].
    """
    all_cores = wall * cpu_count()
    known = {"engine": engine, **parts, "rest": programs - sum(parts.values())}
    known["waiting"] = all_cores - engine - programs
    return {name: known.get(name, 0.0) / all_cores for name in SHARES}
