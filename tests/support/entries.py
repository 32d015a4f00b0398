"""A small entry to verify, and ways to tamper with a copy of it."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import write_zip
from stkzoo.suite import Task
from stkzoo.suite.entry import ENTRY_FILE, replay_digest

#: A driver that samples: it steers like *heuristic*, with noise.
SAMPLER = """\
import numpy as np
from stkzoo.agents.heuristic import create_state, env_name, get_actor as get_driver


def get_actor(*arguments):
    drive = get_driver(*arguments)

    def act(state, observation):
        action = drive(state, observation)
        return {**action, "steer": np.clip(action["steer"] + np.random.normal(0, 0.1), -1, 1)}

    return act
"""

#: Six races of about 400 steps: alone, and against a driver of the population.
SMALL = Task(
    name="small",
    goal="Be verified quickly.",
    train_tracks=("lighthouse",),
    test_tracks=("lighthouse",),
    learners=1,
    forms=("P", "PB"),
    seeds=1,
)


def read_entry(folder: Path) -> dict[str, Any]:
    """Returns the content of ``entry.json``."""
    found: dict[str, Any] = json.loads((folder / ENTRY_FILE).read_text())
    return found


def write_entry(folder: Path, entry: dict[str, Any]) -> None:
    """Writes ``entry.json``."""
    (folder / ENTRY_FILE).write_text(json.dumps(entry))


def replay_of(folder: Path, number: int) -> Path:
    """Returns the file of a replay."""
    return folder / "replays" / f"{number:05d}.stkz"


def change_replay(folder: Path, number: int, change: Callable[[dict[str, bytes]], None]) -> None:
    """Changes the members of a replay."""
    file = replay_of(folder, number)
    with zipfile.ZipFile(file) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    write_zip(file, members)


def change_header(folder: Path, number: int, change: Callable[[dict[str, Any]], None]) -> None:
    """Changes the JSON part of a replay."""

    def edit(members: dict[str, bytes]) -> None:
        header = json.loads(members["race.json"])
        change(header)
        members["race.json"] = json.dumps(header).encode()

    change_replay(folder, number, edit)


def change_controls(
    folder: Path, number: int, change: Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]
) -> None:
    """Changes the controls ``(steps, karts, 7)`` of a replay, which may shorten it."""

    def edit(members: dict[str, bytes]) -> None:
        header = json.loads(members["race.json"])
        shape = -1, len(header["agents"]), 7
        controls = change(np.frombuffer(members["controls.f4"], "<f4").reshape(shape).copy())
        members["controls.f4"] = controls.astype("<f4").tobytes()
        members["digests.u1"] = members["digests.u1"][: 8 * (len(controls) + 1)]
        header["steps"] = len(controls)
        members["race.json"] = json.dumps(header).encode()

    change_replay(folder, number, edit)


def name_replays(folder: Path) -> None:
    """Writes the current SHA-256 digests of the replays to ``entry.json``."""
    entry = read_entry(folder)
    entry["replays"] = [replay_digest(folder, number) for number in range(len(entry["races"]))]
    write_entry(folder, entry)
