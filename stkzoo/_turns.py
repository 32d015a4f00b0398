"""One call at a time: an environment refuses a call while another thread's call runs."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator

from stkzoo.errors import ApiOrderError


class CallTurn:
    """The turn of the call that runs; a thread that has it may call again, as callbacks do.

    :meth:`RaceParallelEnv.step <stkzoo.env.parallel.RaceParallelEnv.step>` takes ``lock`` by
    itself, which costs a tenth of a microsecond; all other calls use :meth:`of`.

    Attributes:
        lock: held while a call runs.
        call: the name of the last call that took the turn.
    """

    __slots__ = ("_pid", "call", "lock")

    def __init__(self) -> None:
        self.call = ""
        self._renew()

    @contextlib.contextmanager
    def of(self, call: str) -> Iterator[None]:
        """Has the turn for a block.

        Args:
            call: the name of the method that runs.

        Raises:
            ApiOrderError: another thread has the turn.
        """
        if not self.lock.acquire(blocking=False):
            self.claim(call)
        self.call = call
        try:
            yield
        finally:
            self.lock.release()

    def claim(self, call: str) -> None:
        """Takes the turn from a thread that a fork has left behind in the parent process.

        Raises:
            ApiOrderError: another thread of this process has the turn.
        """
        if self._pid == os.getpid():
            raise ApiOrderError(
                f"{call}() was called while {self.call}() runs in another thread; wait until that "
                "returns, or make an environment for each thread"
            )
        self._renew()
        self.lock.acquire()

    def __reduce__(self) -> tuple[type[CallTurn], tuple[()]]:
        """A copy of an environment has a turn of its own."""
        return CallTurn, ()

    def _renew(self) -> None:
        self.lock = threading.RLock()
        self._pid = os.getpid()
