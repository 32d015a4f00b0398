"""Helpers for tests of processes."""

import contextlib
import os
import re
import subprocess
import sys
import textwrap
import time
from pathlib import Path

from stkzoo.engine import fork_client
from stkzoo.engine.assets import find_assets


def run_program(code, timeout=60, **options):
    """Runs Python code in a new process; returns the finished process with its output."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=timeout,
        **options,
    )


def process_exists(pid):
    """Returns whether a process exists and is not a zombie."""
    try:
        return "State:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return False


def fork_server_of_races():
    """Returns this program's fork server for the installed game data; tests may start others."""
    return fork_client._fork_servers[os.getpid(), find_assets().root]


def children_of(pid):
    """Returns the sorted ids of a process's children."""
    children = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if f"PPid:\t{pid}\n" in (folder / "status").read_text():
                children.append(int(folder.name))
    return sorted(children)


def wait_until(condition, seconds=5.0):
    """Waits until a condition holds; returns whether it holds at the end."""
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)
    return condition()


@contextlib.contextmanager
def measured(pid="self"):
    """Measures its body: yields a dict for the peak memory [bytes] and the CPU time [s]."""
    cost = {}
    Path(f"/proc/{pid}/clear_refs").write_text("5")  # resets the peak
    memory, seconds = _peak_memory(pid), _cpu_seconds(pid)
    yield cost
    cost["memory"], cost["seconds"] = _peak_memory(pid) - memory, _cpu_seconds(pid) - seconds


def _peak_memory(pid):
    (line,) = re.findall(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return int(line) << 10


def _cpu_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_memory(pid):
    """Returns the resident memory of a process without its children [bytes]."""
    pages = Path(f"/proc/{pid}/statm").read_text().split()[1]
    return int(pages) * 4096
