"""The processes of a program and their roles."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

from tests.support.processes import process_exists

__all__ = ["Member", "family", "marked"]

#: Parts of command lines, and the role of a process with that command line.
_KINDS = (
    ("stkzoo.engine.fork_server", "fork server"),
    ("stkzoo.engine.worker", "race"),
    ("stkzoo.engine.render_process", "drawing"),
    ("stkzoo.drivers.isolated", "agent"),
    ("stkzoo.evaluation.batch.pool", "worker"),
    ("ffmpeg", "encoder"),
)


@dataclass(frozen=True, slots=True)
class Member:
    """One process.

    Attributes:
        pid: process id.
        parent: process id of the parent.
        kind: role of the process: ``"fork server"``, ``"race"``, ``"drawing"``, ``"agent"``,
            ``"worker"``, ``"encoder"`` or ``"other"``.
    """

    pid: int
    parent: int
    kind: str


def family(program: int) -> list[Member]:
    """Returns all live descendants of a program, the oldest generation first."""
    members: list[Member] = []
    generation = {program: "other"}
    while generation:
        following: dict[int, str] = {}
        for parent, kind in generation.items():
            for pid in filter(process_exists, _children(parent)):
                following[pid] = "race" if kind == "fork server" else _kind(pid)
                members.append(Member(pid, parent, following[pid]))
        generation = following
    return members


def marked(text: str) -> list[int]:
    """Returns the ids of all live processes whose environment contains a text."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            environment, pid = (folder / "environ").read_bytes(), int(folder.name)
            if text.encode() in environment and process_exists(pid):
                found.append(pid)
    return sorted(found)


def _children(pid: int) -> list[int]:
    """Returns the children of all threads of a process."""
    found = []
    for thread in Path(f"/proc/{pid}/task").glob("*"):
        with contextlib.suppress(OSError):
            found.extend(map(int, (thread / "children").read_text().split()))
    return found


def _kind(pid: int) -> str:
    with contextlib.suppress(OSError):
        words = Path(f"/proc/{pid}/cmdline").read_bytes().decode(errors="replace")
        for text, kind in _KINDS:
            if text in words:
                return kind
    return "other"
