"""Failures of agents as text: the error, its traceback, the last lines of the output."""

from __future__ import annotations

import importlib
import threading
import traceback
from pathlib import Path
from typing import IO, Any

from stkzoo.errors import AgentError, AgentTimeout, ProtocolError, StkzooError

_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORTLIB = Path(importlib.__file__).parent
_MAX_FRAMES = 30
_MAX_TEXT = 4000
_KEPT_BYTES, _KEPT_LINES = 8192, 20


def in_words(error: BaseException) -> str:
    """The error's type and text; only the text for stkzoo's own errors."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - the agent's own class
        text = "(its __str__ failed)"
    if isinstance(error, ModuleNotFoundError):
        text += _importer(error)
    return text if isinstance(error, StkzooError) else f"{type(error).__name__}: {text}"


def _importer(error: ModuleNotFoundError) -> str:
    """Which line of an agent needs a module that is missing, and what to do."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _is_ours(f.filename)]
    if not frames:
        return ""
    file, line = Path(frames[-1].filename).name, frames[-1].lineno
    return f" ({file}, line {line}); install it, or put it into the agent's folder"


def printable(text: object, limit: int | None = None) -> str:
    """Text from outside, safe for a terminal: no control codes, at most ``limit`` characters."""
    letters = (letter if letter.isprintable() or letter in "\n\t" else "?" for letter in str(text))
    return "".join(letters)[:limit]


def agent_trace(error: BaseException) -> str:
    """The traceback without the leading frames of stkzoo; empty if there are no others.

    An agent's author cannot change stkzoo's frames. An error that stkzoo found, such as an action
    of the wrong shape, or a missing module, is complete in its text.
    """
    if isinstance(error, ModuleNotFoundError):
        return ""
    trace = traceback.TracebackException.from_exception(error)
    has_frames = False
    link: traceback.TracebackException | None = trace
    while link is not None:
        frames = list(link.stack)
        start = next((i for i, f in enumerate(frames) if not _is_ours(f.filename)), len(frames))
        link.stack = traceback.StackSummary.from_list(frames[start:][-_MAX_FRAMES:])
        has_frames = has_frames or bool(link.stack)
        link = link.__cause__ or link.__context__
    return "".join(trace.format()) if has_frames else ""


def _is_ours(file: str) -> bool:
    is_importing = file.startswith("<frozen importlib") or Path(file).is_relative_to(_IMPORTLIB)
    return is_importing or Path(file).is_relative_to(_PACKAGE)


def error_report(error: BaseException) -> list[str]:
    """An agent's error as a part of a message: its kind, its text and its traceback."""
    kind = "timeout" if isinstance(error, AgentTimeout) else "error"
    trace = error.trace if isinstance(error, AgentError) else agent_trace(error)
    return [kind, printable(in_words(error), _MAX_TEXT), printable(trace[-_MAX_TEXT:])]


def reported_error(report: Any, agent: str) -> AgentError:
    """The error that :func:`error_report` described, to be raised for an agent.

    Raises:
        ProtocolError: the report has another form.
    """
    match report:
        case [str(kind), str(text), str(trace)]:
            error = AgentTimeout if kind == "timeout" else AgentError
            return error(printable(text, _MAX_TEXT), agent, printable(trace, _MAX_TEXT))
    raise ProtocolError(f"an error {report!r:.100}, expected its kind, text and traceback")


class OutputTail:
    """Reads a process's output, so that the process never blocks, and keeps the last lines.

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
        """The last lines received so far."""
        lines = self._tail.decode(errors="replace").splitlines()
        return "\n".join(lines[-_KEPT_LINES:])

    def close(self) -> None:
        """Waits briefly for the last lines of a process that has ended."""
        self._thread.join(0.5)
        if not self._thread.is_alive():
            self._stream.close()

    def _read(self) -> None:
        while block := self._stream.read1(65536):  # type: ignore[attr-defined]
            self._tail = (self._tail + block)[-_KEPT_BYTES:]
