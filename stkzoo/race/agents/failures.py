"""What an agent that failed leaves: its error in words, its traceback, its last lines of output."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import IO

from stkzoo.errors import StkzooError

__all__ = ["OutputTail", "agent_trace", "in_words", "printable"]

_PACKAGE = Path(__file__).resolve().parents[2]
_MAX_FRAMES = 30
_KEEP = 8192  # [bytes]
_LINES = 20


def in_words(error: BaseException) -> str:
    """The error's kind and text; of stkzoo's own, which explain themselves, the text alone."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - the agent's own class
        text = "(its text cannot be had)"
    return text if isinstance(error, StkzooError) else f"{type(error).__name__}: {text}"


def printable(text: object) -> str:
    """What somebody else wrote, fit for a terminal: no control codes."""
    letters = (letter if letter.isprintable() or letter in "\n\t" else "?" for letter in str(text))
    return "".join(letters)


def agent_trace(error: BaseException) -> str:
    """The traceback from the first line on that is not stkzoo's; empty if all are.

    An error that stkzoo found, such as an action of the wrong shape, says it all in its text.
    """
    trace = traceback.TracebackException.from_exception(error)
    links = list(_chain_of(trace))
    for link in links:
        frames = list(link.stack)
        start = next((i for i, f in enumerate(frames) if not _is_ours(f.filename)), len(frames))
        link.stack = traceback.StackSummary.from_list(frames[start:][-_MAX_FRAMES:])
    return "".join(trace.format()) if any(link.stack for link in links) else ""


def _chain_of(
    trace: traceback.TracebackException | None,
) -> Iterable[traceback.TracebackException]:
    while trace is not None:
        yield trace
        trace = trace.__cause__ or trace.__context__


def _is_ours(file: str) -> bool:
    return file.startswith("<frozen importlib") or Path(file).is_relative_to(_PACKAGE)


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
