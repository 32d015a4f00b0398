"""Signals that end a command: it stops like after Ctrl-C, and keeps what it has so far."""

from __future__ import annotations

import os
import signal
import threading
import time
from types import FrameType
from typing import TYPE_CHECKING

from stkzoo.cli._arguments import INTERRUPTED

if TYPE_CHECKING:
    from typing_extensions import Self  # a dependency of gymnasium

#: ``kill``, job schedulers and time limits send SIGTERM, a closed terminal SIGHUP.
_SIGNALS = [
    signal.Signals[name] for name in ("SIGTERM", "SIGHUP") if name in signal.Signals.__members__
]
#: Signals that follow the first one this closely repeat it, as those of ``timeout`` do [s].
_REPEATED = 1.0


class Ended(KeyboardInterrupt):
    """SIGTERM or SIGHUP came.

    If a plain KeyboardInterrupt ends an ``exec``, such as that of a dataclass during an import,
    ``python -m`` exits by SIGINT instead of with the code of the signal.
    """


class EndSignals:
    """Context manager in which the first SIGTERM or SIGHUP raises :class:`Ended`.

    A later one ends the program at once. Signals that the program ignores stay ignored, as with
    ``nohup``. In other threads than the main one, this changes nothing.
    """

    def __init__(self) -> None:
        self._terminals = [descriptor for descriptor in (1, 2) if os.isatty(descriptor)]
        self._handled: list[signal.Signals] = []
        self._number = 0
        self._since = 0.0

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            self._handled = [n for n in _SIGNALS if signal.getsignal(n) is signal.SIG_DFL]
        for number in self._handled:
            signal.signal(number, self._end)
        return self

    def __exit__(self, *_: object) -> None:
        for number in self._handled:
            signal.signal(number, signal.SIG_DFL)

    def exit_code(self, code: int) -> int:
        """Returns 128 + the signal's number if a signal interrupted the command, else ``code``."""
        return 128 + self._number if self._number and code == INTERRUPTED else code

    def _end(self, number: int, _: FrameType | None) -> None:
        if not self._number:
            self._number, self._since = number, time.monotonic()
            self._leave_closed_terminals()
            raise Ended
        if time.monotonic() - self._since > _REPEATED:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)

    def _leave_closed_terminals(self) -> None:
        """Discards output to a closed terminal, which would be an error in the cleanup."""
        for descriptor in self._terminals:
            if not os.isatty(descriptor):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, descriptor)
                os.close(null)
