"""Handling of standard streams that are closed, full, or not in UTF-8."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from stkzoo.errors import StkzooError, reason


def prepare_streams() -> None:
    """Opens closed standard streams on the null device, and lets stdout print any text.

    Otherwise, the next file or socket would get the number of a closed stream. Writing to a closed
    stdout is an error (:func:`writing_stdout`). Output to a closed stderr is lost.
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
    """Opens the null device with a given descriptor number."""
    descriptor = os.open(os.devnull, flags)
    if descriptor != number:
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.set_inheritable(number, True)


@contextmanager
def writing_stdout() -> Iterator[None]:
    """Raises a one-line error if stdout is closed or full when the block writes to it.

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
