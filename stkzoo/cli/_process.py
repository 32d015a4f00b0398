"""How a command ends early: by a signal, or because stdout is full or its reader has ended."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from stkzoo.errors import StkzooError, reason

#: Exit codes when an agent failed and after Ctrl-C.
AGENT_FAILED, INTERRUPTED = 3, 130

#: ``kill``, job schedulers and time limits send SIGTERM, a closed terminal SIGHUP.
_SIGNALS = (signal.SIGTERM, signal.SIGHUP)


class Ended(KeyboardInterrupt):
    """SIGTERM or SIGHUP came. ``python -m`` reports a plain KeyboardInterrupt as SIGINT."""


@contextmanager
def end_signals() -> Iterator[list[int]]:
    """Raises :class:`Ended` in the block at the first SIGTERM or SIGHUP.

    Later ones are ignored, because ``timeout`` sends each signal twice. Signals that the program
    ignores stay ignored, as with ``nohup``.

    Yields:
        A list that then contains the signal's number.
    """
    came: list[int] = []

    def end(number: int, _: FrameType | None) -> None:
        if not came:
            came.append(number)
            raise Ended

    handled = [n for n in _SIGNALS if signal.getsignal(n) is signal.SIG_DFL]
    for number in handled:
        signal.signal(number, end)
    try:
        yield came
    finally:
        for number in handled:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def writing_stdout() -> Iterator[None]:
    """Raises a one-line error if stdout is full when the block writes to it.

    Other errors of the block are not changed.

    Raises:
        StkzooError: stdout cannot be written. Later output to it is discarded.
        BrokenPipeError: the reader of stdout has ended.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError:
        _write("\n")  # also fails if the block's error came from stdout
        raise
    _write()


def _write(text: str = "") -> None:
    try:
        sys.stdout.write(text)
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        discard_stdout()
        raise StkzooError(
            f"stdout cannot be written: {reason(error)}; send it to another file"
        ) from error


def discard_stdout() -> None:
    """Discards later output to stdout, and output that has not been flushed yet."""
    with suppress(OSError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
