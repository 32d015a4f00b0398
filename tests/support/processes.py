"""What tests of processes share: programs of their own, and who still lives."""

import contextlib
import subprocess
import sys
import textwrap
import time
from pathlib import Path


def run_program(code, **options):
    """Runs a program of its own and returns it finished, output included."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=60,
        **options,
    )


def process_exists(pid):
    """Whether a process is there and no zombie."""
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


def children_of(pid):
    """Ids of the processes that have this one as their parent, sorted."""
    children = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if f"PPid:\t{pid}\n" in (folder / "status").read_text():
                children.append(int(folder.name))
    return sorted(children)


def wait_until(condition, seconds=5.0):
    """Waits until something holds; whether it does in the end."""
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)
    return condition()
