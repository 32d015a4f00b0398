"""Formats failures of agents: the error, its traceback and the last lines of output."""

from __future__ import annotations

import importlib
import json
import os
import select
import sys
import sysconfig
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import IO

from stkzoo._schema import ESCAPES, plain_text
from stkzoo.errors import StkzooError

_PACKAGE = Path(__file__).resolve().parents[1]
_IMPORTLIB = Path(importlib.__file__).parent
_LIBRARIES = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
_MAX_FRAMES = 30
#: Maximum length of an error or a traceback [characters].
MAX_TEXT = 4000
_KEPT_BYTES, _KEPT_LINES = 8192, 20
#: Limits of the output shown for one process: bytes per line, and lines.
_LINE_BYTES, _MAX_LINES = 300, 5000


def in_words(error: BaseException) -> str:
    """Returns an error's type and text; for stkzoo's own errors, only the text."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - the agent's class may do anything
        text = "(its __str__ failed)"
    if isinstance(error, ModuleNotFoundError):
        text += _importer(error)
    return bounded(text if isinstance(error, StkzooError) else f"{type(error).__name__}: {text}")


def _importer(error: ModuleNotFoundError) -> str:
    """Returns the agent's line that imports a missing module, and how to fix it."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not _is_ours(f.filename)]
    if not frames:
        return ""
    file, line = Path(frames[-1].filename).name, frames[-1].lineno
    return (
        f" ({file}, line {line}); install it (not with pip's -e), or put it into the agent's folder"
    )


def bounded(text: str, limit: int = MAX_TEXT) -> str:
    """Shortens a text above ``limit`` characters to its beginning and end."""
    if len(text) <= limit:
        return text
    half = limit // 2
    return f"{text[:half]} ... ({len(text) - 2 * half} characters left out) ... {text[-half:]}"


def fitted(text: str, size: int) -> str:
    """Shortens a text to a size in a JSON file.

    Args:
        text: the text.
        size: maximum size, as :func:`json_size` measures it [bytes].

    Returns:
        The text or, if it is too large, its beginning and end; empty if ``size`` is too small.
    """
    limit = len(text)
    while limit and json_size(bounded(text, limit)) > size:
        limit //= 2
    return bounded(text, limit) if limit else ""


def json_size(text: str) -> int:
    """Returns the size of a text in a JSON file [bytes]."""
    return len(json.dumps(text))


def printable(text: object, limit: int | None = None) -> str:
    """Makes untrusted text safe for a terminal: removes control codes and limits its length.

    Args:
        text: the text.
        limit: maximum length [characters]; ``None`` for no limit.
    """
    beginning = str(text)[: None if limit is None else 4 * limit]
    return plain_text(ESCAPES.sub("", beginning)[:limit])


def agent_trace(error: BaseException) -> str:
    """Returns the traceback with the agent's frames only; an empty string if there are none.

    Frames of stkzoo, of Python's import system and of libraries are removed. File names are
    relative to the folder of the agent's first frame. A missing module, and an error that stkzoo
    detects, such as an action of the wrong shape, have no traceback: their text is complete.
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
        if isinstance(file := getattr(link, "filename", None), str):  # a syntax error
            link.filename = _relative(file, home)
    return bounded("".join(trace.format())).rstrip()


def _relative(file: str, home: Path) -> str:
    return str(Path(file).relative_to(home)) if Path(file).is_relative_to(home) else file


def _chain(trace: traceback.TracebackException | None) -> Iterator[traceback.TracebackException]:
    """Yields an error and its causes."""
    while trace is not None:
        yield trace
        trace = trace.__cause__ or (None if trace.__suppress_context__ else trace.__context__)


def _own_frames(stack: traceback.StackSummary) -> list[traceback.FrameSummary]:
    """Returns the agent's frames, or library frames if the agent has none."""
    others = [frame for frame in stack if not _is_ours(frame.filename)]
    return [frame for frame in others if not _is_library(frame.filename)] or others


def _is_ours(file: str) -> bool:
    is_importing = file.startswith("<frozen ") or Path(file).is_relative_to(_IMPORTLIB)
    return is_importing or Path(file).is_relative_to(_PACKAGE)


def _is_library(file: str) -> bool:
    return any(Path(file).is_relative_to(folder) for folder in _LIBRARIES)


class OutputTail:
    """Keeps the last lines of a process's output. A thread reads it, so the process never blocks.

    Args:
        stream: read end of the process's output.
        label: prefix of each line that is shown on stderr; if empty, the output is not shown.
    """

    def __init__(self, stream: IO[bytes] | None, label: str = "") -> None:
        assert stream is not None  # noqa: S101 - opened as a pipe
        self._stream, self._label = stream, label
        self._tail = self._line = b""
        self._num_shown = 0
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def text(self, lines: int = _KEPT_LINES) -> str:
        """Returns the last lines received so far."""
        text = printable(self._tail.decode(errors="replace"))
        return "\n".join(line[:_LINE_BYTES] for line in text.splitlines()[-lines:])

    def wait(self, seconds: float = 0.1) -> None:
        """Waits until all output that the process has written is read, up to a timeout [s]."""
        deadline = time.monotonic() + seconds
        with suppress(ValueError):  # the thread has closed the stream
            while self._is_readable() and time.monotonic() < deadline:
                time.sleep(0.001)
        time.sleep(0.002)  # the thread may not have stored its last block yet

    def close(self) -> None:
        """Waits briefly for the last lines of a process that has ended.

        If an escaped process still holds the other end of the pipe, the thread continues.
        """
        self._thread.join(0.5)

    def _read(self) -> None:
        with self._stream:
            while block := os.read(self._stream.fileno(), 65536):
                self._tail = (self._tail + block)[-_KEPT_BYTES:]
                if self._label:
                    self._show(block)
        if self._line:
            self._show(b"\n")

    def _is_readable(self) -> bool:
        poll = select.poll()
        poll.register(self._stream, select.POLLIN)
        return bool(poll.poll(0))

    def _show(self, block: bytes) -> None:
        """Writes the complete lines to stderr, up to a maximum number."""
        *lines, self._line = (self._line + block).split(b"\n")
        if len(self._line) > _LINE_BYTES:
            lines, self._line = [*lines, self._line], b""
        for line in lines[: _MAX_LINES + 1 - self._num_shown]:
            self._num_shown += 1
            text = printable(line[:_LINE_BYTES].decode(errors="replace").rstrip("\r"))
            if self._num_shown > _MAX_LINES:
                text = "(more output is not shown)"
            sys.stderr.write(f"{self._label} | {text}\n")
