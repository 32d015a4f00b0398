"""The last lines that a process writes."""

from __future__ import annotations

import threading
from typing import IO

__all__ = ["OutputTail"]

_KEEP = 8192  # [bytes]
_LINES = 20


class OutputTail:
    """Reads what a process writes so that it never waits, and keeps the end of it.

    Args:
        stream: the reading end of its output.
    """

    def __init__(self, stream: IO[bytes] | None) -> None:
        assert stream is not None  # noqa: S101 - opened as a pipe
        self._stream = stream
        self._tail = b""
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def text(self) -> str:
        """The last lines, as far as they have come."""
        lines = self._tail.decode(errors="replace").splitlines()
        return "\n".join(lines[-_LINES:])

    def close(self) -> None:
        """Waits a little for the last lines of a process that has ended."""
        self._thread.join(0.5)
        if not self._thread.is_alive():
            self._stream.close()

    def _read(self) -> None:
        while block := self._stream.read1(65536):  # type: ignore[attr-defined]
            self._tail = (self._tail + block)[-_KEEP:]
