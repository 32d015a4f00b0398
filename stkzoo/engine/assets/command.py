"""Running other programs that take long, and watching them."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from stkzoo.errors import AssetError

__all__ = ["run"]

_LOOK_EVERY = 0.1  # [s]


def run(
    command: Sequence[str],
    *,
    folder: Path,
    watch: Callable[[], None] = lambda: None,
    name: str = "",
    last_lines: int = 8,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Runs a program to its end.

    Args:
        command: the program and its arguments.
        folder: where it runs.
        watch: called a few times a second meanwhile; what it raises ends the program.
        name: what the message calls it; the command itself by default.
        last_lines: how much of its output the message shows.
        environment: variables; ``None`` for our own.

    Returns:
        What it wrote.

    Raises:
        AssetError: it failed; the message carries its last lines.
    """
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as log:
        process = subprocess.Popen(  # noqa: S603 - a fixed program, no shell
            [*_dying_with_us(), *command],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            _wait(process, watch)
        finally:
            _end(process)
        log.seek(0)
        text = log.read()
    if process.returncode != 0:
        name = name or f"`{' '.join(command)}`"
        lines = "\n".join(text.strip().splitlines()[-last_lines:])
        raise AssetError(f"{name} failed ({process.returncode}): {lines}")
    return text


def _dying_with_us() -> list[str]:
    """A prefix that ends the program when we are killed, where the system has one."""
    setpriv = shutil.which("setpriv") if os.name == "posix" else None
    return [setpriv, "--pdeathsig", "TERM", "--"] if setpriv else []


def _wait(process: subprocess.Popen[bytes], watch: Callable[[], None]) -> None:
    while process.poll() is None:
        watch()
        time.sleep(_LOOK_EVERY)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
