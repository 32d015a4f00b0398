"""Times the engine's own steps, in the process in which they run.

:func:`time_the_engine` wraps ``pystk2.Race`` when it is imported. The duration of the last step is
stored in memory that a process shares with its children, so that the caller can read it. The
wrapper costs about a microsecond per step. This module needs only the standard library.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import mmap
import os
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

#: Environment variable with the clock's file; ``instrument/sitecustomize.py`` reads it.
CLOCK_VARIABLE = "STKZOO_BENCH_CLOCK"

_SECONDS = struct.Struct("<d")
_SIZE = 4096


class Clock:
    """The duration of the last step, in memory shared with other processes.

    Args:
        path: :attr:`path` of another process's clock; ``None`` makes a new one.
    """

    def __init__(self, path: str | None = None) -> None:
        if path is None:
            self._file: Any = tempfile.TemporaryFile(prefix="stkzoo-bench-")  # noqa: SIM115
            self._file.truncate(_SIZE)
        else:
            self._file = open(path, "r+b", buffering=0)  # noqa: SIM115 - open while mapped
        self._memory = mmap.mmap(self._file.fileno(), _SIZE)

    @property
    def path(self) -> str:
        """Path under which other processes open this clock; its file is unnamed."""
        return f"/proc/{os.getpid()}/fd/{self._file.fileno()}"

    def set(self, seconds: float) -> None:
        """Stores the duration of a step [s]."""
        _SECONDS.pack_into(self._memory, 0, seconds)

    def take(self) -> float | None:
        """Returns and clears the duration of the last step [s]; ``None`` without a new step."""
        (seconds,) = _SECONDS.unpack_from(self._memory)
        self.set(0.0)
        return float(seconds) or None


def time_the_engine(clock: Clock) -> None:
    """Times the engine's steps once ``pystk2`` is imported."""

    def time_race(module: Any) -> None:
        module.Race = _timed_race(module.Race, clock)

    sys.meta_path.insert(0, _AfterImport({"pystk2": time_race}))


def _timed_race(race_class: Any, clock: Clock) -> type:
    class TimedRace:
        def __init__(self, *arguments: Any) -> None:
            self._race = race_class(*arguments)
            self._step = self._race.step

        def step(self, *actions: Any) -> Any:
            if not actions:  # a warm-up step, perhaps of another race
                return self._step()
            start = time.perf_counter()
            result = self._step(*actions)
            clock.set(time.perf_counter() - start)
            return result

        def __getattr__(self, name: str) -> Any:
            return getattr(self._race, name)

    return TimedRace


class _AfterImport(importlib.abc.MetaPathFinder):
    """Changes some modules right after their import."""

    def __init__(self, changes: dict[str, Callable[[ModuleType], None]]) -> None:
        self._changes = changes

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name not in self._changes:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _Loader(spec.loader, self._changes[name])
        return spec


class _Loader(importlib.abc.Loader):
    def __init__(self, loader: Any, change: Callable[[ModuleType], None]) -> None:
        self._loader = loader
        self._change = change

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        module: ModuleType | None = self._loader.create_module(spec)
        return module

    def exec_module(self, module: ModuleType) -> None:
        self._loader.exec_module(module)
        self._change(module)
