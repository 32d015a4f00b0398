"""What tests of processes share: programs of their own, and who still lives."""

import contextlib
import os
import re
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


@contextlib.contextmanager
def measured(pid="self"):
    """Measures a process in its body: peak of its memory above the start [bytes], CPU seconds."""
    cost = {}
    Path(f"/proc/{pid}/clear_refs").write_text("5")  # makes the peak what it is now
    memory, seconds = _peak_memory(pid), _cpu_seconds(pid)
    yield cost
    cost["memory"], cost["seconds"] = _peak_memory(pid) - memory, _cpu_seconds(pid) - seconds


def _peak_memory(pid):
    (line,) = re.findall(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    return int(line) << 10


def _cpu_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
