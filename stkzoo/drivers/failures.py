"""Failures of agents as text: the error, its traceback, the last lines of the output."""

from __future__ import annotations

import importlib
import os
import re
import select
import sys
import sysconfig
import threading
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from stkzoo._schema import plain_text
from stkzoo.errors import AgentError, AgentTimeout, ProtocolError, StkzooError, shortened

_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORTLIB = Path(importlib.__file__).parent
_LIBRARIES = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
_MAX_FRAMES = 30
_MAX_TEXT = 4000
#: Characters of an agent's value in an error: more than an action of a usual space has.
_MAX_VALUE = 1000
_KEPT_BYTES, _KEPT_LINES = 8192, 20
#: Escape sequences of terminals, such as colors and window titles.
_ESCAPES = re.compile(r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)?)")
#: Shown output of one process: bytes in a line, and lines.
_LINE_BYTES, _MAX_LINES = 300, 5000
#: How often a reader of output looks whether it must end [ms].
_POLL = 200


def in_words(error: BaseException) -> str:
    """The error's type and text; only the text for stkzoo's own errors."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - the agent's own class
        text = "(its __str__ failed)"
    if isinstance(error, ModuleNotFoundError):
        text += _importer(error)
    return bounded(text if isinstance(error, StkzooError) else f"{type(error).__name__}: {text}")


def _importer(error: ModuleNotFoundError) -> str:
    """Which line of an agent needs a module that is missing, and what to do."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _is_ours(f.filename)]
    if not frames:
        return ""
    file, line = Path(frames[-1].filename).name, frames[-1].lineno
    return f" ({file}, line {line}); install it, or put it into the agent's folder"


def bounded(text: str, limit: int = _MAX_TEXT) -> str:
    """The beginning and the end of a long text."""
    if len(text) <= limit:
        return text
    half = limit // 2
    return f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"


def value_in_words(value: object) -> str:
    """The ``repr`` of an agent's value, of bounded length."""
    return shortened(value, _MAX_VALUE)


def printable(text: object, limit: int | None = None) -> str:
    """Text from outside, safe for a terminal: no control codes, at most ``limit`` characters."""
    beginning = str(text)[: None if limit is None else 4 * limit]
    return plain_text(_ESCAPES.sub("", beginning)[:limit])


def agent_trace(error: BaseException) -> str:
    """The traceback with the agent's own frames only; empty if there are none.

    The frames of stkzoo, of Python's import system and of libraries say nothing about the agent,
    whose files are named relative to its first one. An error that stkzoo found, such as an action
    of the wrong shape, or a missing module, is complete in its text.
    """
    if isinstance(error, ModuleNotFoundError):
        return ""
    trace = traceback.TracebackException.from_exception(error)
    links = list(_chain(trace))
    for link in links:
        link.stack = traceback.StackSummary.from_list(_own_frames(link.stack)[-_MAX_FRAMES:])
    frames = [frame for link in reversed(links) for frame in link.stack]
    if not frames and not isinstance(error, SyntaxError):
        return ""
    home = Path(frames[0].filename if frames else trace.filename or "").parent
    for frame in frames:
        frame.filename = _relative(frame.filename, home)
    for link in links:
        if isinstance(file := getattr(link, "filename", None), str):  # a syntax error's
            link.filename = _relative(file, home)
    return bounded("".join(trace.format())).rstrip()


def _relative(file: str, home: Path) -> str:
    return str(Path(file).relative_to(home)) if Path(file).is_relative_to(home) else file


def _chain(trace: traceback.TracebackException | None) -> Iterator[traceback.TracebackException]:
    """An error and those that led to it."""
    while trace is not None:
        yield trace
        trace = trace.__cause__ or (None if trace.__suppress_context__ else trace.__context__)


def _own_frames(stack: traceback.StackSummary) -> list[traceback.FrameSummary]:
    """The frames of an agent; those of libraries if the agent has none."""
    others = [frame for frame in stack if not _is_ours(frame.filename)]
    return [frame for frame in others if not _is_library(frame.filename)] or others


def _is_ours(file: str) -> bool:
    is_importing = file.startswith("<frozen ") or Path(file).is_relative_to(_IMPORTLIB)
    return is_importing or Path(file).is_relative_to(_PACKAGE)


def _is_library(file: str) -> bool:
    return any(Path(file).is_relative_to(folder) for folder in _LIBRARIES)


def error_report(error: BaseException) -> list[str]:
    """An agent's error as a part of a message: its kind, its text and its traceback."""
    kind = "timeout" if isinstance(error, AgentTimeout) else "error"
    trace = error.trace if isinstance(error, AgentError) else agent_trace(error)
    return [kind, printable(in_words(error), _MAX_TEXT), printable(bounded(str(trace)))]


def reported_error(report: Any, agent: str) -> AgentError:
    """The error that :func:`error_report` described, to be raised for an agent.

    Raises:
        ProtocolError: the report has another form.
    """
    match report:
        case [str(kind), str(text), str(trace)]:
            error = AgentTimeout if kind == "timeout" else AgentError
            return error(printable(text, _MAX_TEXT), agent, printable(trace, _MAX_TEXT))
    raise ProtocolError(f"an error {shortened(report, 100)}, expected its kind, text and traceback")


class OutputTail:
    """Reads a process's output, so that the process never blocks, and keeps the last lines.

    Args:
        stream: the reading end of its output.
        label: shows the output on stderr, with this before each line; empty to show nothing.
    """

    def __init__(self, stream: IO[bytes] | None, label: str = "") -> None:
        assert stream is not None  # noqa: S101 - opened as a pipe
        self._stream, self._label = stream, label
        self._tail = self._line = b""
        self._num_shown = 0
        self._is_closing = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def show_as(self, label: str) -> None:
        """Changes the label of the lines that follow, and counts them from 0."""
        self._label, self._num_shown = label, 0

    def text(self, lines: int = _KEPT_LINES) -> str:
        """The last lines received so far."""
        text = printable(self._tail.decode(errors="replace"))
        return "\n".join(line[:_LINE_BYTES] for line in text.splitlines()[-lines:])

    def wait(self, seconds: float = 0.1) -> None:
        """Waits until everything that the process has written is read, for some time."""
        deadline = time.monotonic() + seconds
        while self._thread.is_alive() and time.monotonic() < deadline:
            if not self._is_readable(0):
                time.sleep(0.002)  # for the thread to keep what it has just read
                return
            time.sleep(0.001)

    def close(self) -> None:
        """Waits briefly for the last lines of a process that has ended.

        A process that has escaped may still hold the other end; that costs it its output.
        """
        self._thread.join(0.5)
        self._is_closing = True
        self._thread.join(2 * _POLL / 1000)
        if not self._thread.is_alive():
            self._stream.close()

    def _read(self) -> None:
        while block := self._next():
            self._tail = (self._tail + block)[-_KEPT_BYTES:]
            if self._label:
                self._show(block)
        if self._line:
            self._show(b"\n")

    def _next(self) -> bytes:
        """The next output; empty at its end."""
        while not self._is_closing:
            if not hasattr(select, "poll") or self._is_readable(_POLL):
                return os.read(self._stream.fileno(), 65536)
        return b""

    def _is_readable(self, milliseconds: int) -> bool:
        poll = select.poll()
        poll.register(self._stream, select.POLLIN)
        return bool(poll.poll(milliseconds))

    def _show(self, block: bytes) -> None:
        """Shows the complete lines, up to a limit."""
        *lines, self._line = (self._line + block).split(b"\n")
        if len(self._line) > _LINE_BYTES:
            lines, self._line = [*lines, self._line], b""
        for line in lines[: _MAX_LINES + 1 - self._num_shown]:
            self._num_shown += 1
            text = printable(line[:_LINE_BYTES].decode(errors="replace").rstrip("\r"))
            if self._num_shown > _MAX_LINES:
                text = "(more output is not shown)"
            sys.stderr.write(f"{self._label} | {text}\n")
