"""Standard streams that are closed, full, or of another encoding."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from stkzoo.errors import StkzooError, reason


def prepare_streams() -> None:
    """Opens the standard streams that are closed, and lets stdout show any text.

    Without this the next file or socket would get the number of a closed stream. What is written
    to a closed stdout is an error (:func:`writing_stdout`); a closed stderr loses it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            is_lost = name == "stderr"
            _open(number, os.O_WRONLY if is_lost else os.O_RDONLY)
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(number, mode, closefd=False, encoding="utf-8"))  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def _open(number: int, flags: int) -> None:
    """Opens the null device with a number."""
    descriptor = os.open(os.devnull, flags)
    if descriptor != number:
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.set_inheritable(number, True)


@contextmanager
def writing_stdout() -> Iterator[None]:
    """Reports in one line that stdout, which this block writes, is closed or full.

    Other errors of the block stay as they are.

    Raises:
        StkzooError: stdout cannot be written; from then on what is written to it is lost.
        BrokenPipeError: its reader is gone.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError:
        _write("\n")  # which fails too if it was stdout that failed
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
    """Makes stdout lose what is written to it, and what it has not written yet."""
    with suppress(OSError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
