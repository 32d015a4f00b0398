"""A guard against concurrent calls: an environment rejects calls during another thread's call."""

from __future__ import annotations

import threading

from stkzoo.errors import ApiOrderError


class CallTurn:
    """A turn that one thread holds during a call: ``with turn:``.

    The same thread can nest calls, as callbacks and signal handlers do.

    Raises:
        ApiOrderError: another thread has the turn.
    """

    __slots__ = ("_lock",)

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise ApiOrderError(
                "another thread's call runs; wait until it returns, or make an environment for "
                "each thread"
            )

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type[CallTurn], tuple[()]]:
        """Pickles as a new turn, so each copy of an environment has its own turn."""
        return CallTurn, ()
