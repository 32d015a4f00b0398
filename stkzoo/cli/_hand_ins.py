"""Hand-ins of a course: chooses the zip that races for each participant."""

from __future__ import annotations

import shutil
import sys
from collections import defaultdict
from collections.abc import Iterable
from contextlib import ExitStack
from datetime import datetime
from pathlib import Path

from stkzoo._locks import locked_folder
from stkzoo._os import make_folder, write_whole
from stkzoo._schema import plain_text
from stkzoo.cli._batch import file_name
from stkzoo.drivers.files import AgentFiles, is_zip
from stkzoo.errors import ConfigError


def collect_agents(hand_ins: Path | None, limit: str | None, folder: Path) -> tuple[str, ...]:
    """Copies the newest valid hand-in of each participant, and returns the paths of the copies.

    A copy that exists stays, so the tournament can resume after newer hand-ins. Prints on stderr
    which zips are late or invalid, or newer than the copy.

    Args:
        hand_ins: folder with a zip, or a folder of zips, for each participant; ``None`` for none.
        limit: the deadline, in ISO format; ``None`` for none.
        folder: folder of the tournament.

    Raises:
        ConfigError: the deadline is invalid or in the future, or a folder cannot be used.
    """
    if hand_ins is None and limit is None:
        return ()
    if hand_ins is None or not hand_ins.is_dir():
        raise ConfigError(f"--hand-ins is {hand_ins}, expected the folder of the hand-ins")
    deadline = None if limit is None else _past_time(limit)
    zips: dict[str, list[Path]] = defaultdict(list)
    for entry in sorted(hand_ins.glob("[!.]*")):
        is_folder = entry.is_dir() and not entry.is_symlink()
        name = entry.name if is_folder else entry.stem
        zips[file_name(name)] += entry.glob("[!.]*") if is_folder else [entry]
    copies = folder / "hand-ins"
    with locked_folder(folder, "tournament"):
        make_folder(copies, "tournament")
        for name, files in zips.items():
            _copy_newest(files, copies / f"{name}.zip", deadline)
    return tuple(map(str, sorted(copies.glob("*.zip"))))


def _copy_newest(files: Iterable[Path], copy: Path, deadline: datetime | None) -> None:
    """Copies the newest valid zip among files, unless there is a copy."""
    for file in sorted(files, key=_time_of, reverse=True):
        if copy.exists() and _time_of(file) <= _time_of(copy):
            return
        try:
            _check(file, copy, deadline)
        except ConfigError as error:
            print(f"stkzoo: left out: {plain_text(str(error))}", file=sys.stderr)
            continue
        with write_whole(copy, "the hand-in") as part:
            shutil.copyfile(file, part)
        return


def _check(file: Path, copy: Path, deadline: datetime | None) -> None:
    """Checks that a hand-in is a zip with an agent, in time, and the first for a copy.

    Raises:
        ConfigError: it is not.
    """
    if deadline is not None and _time_of(file) > deadline:
        raise ConfigError(f"{file} is late: it was changed at {_time_of(file):%Y-%m-%d %H:%M:%S}")
    if copy.exists():
        raise ConfigError(f"{file} is newer than {copy}; for another round, choose a new --output")
    if not is_zip(file) or file.is_symlink() or not file.is_file():
        raise ConfigError(f"{file} is not a zip")
    with ExitStack() as resources:
        AgentFiles(str(file), file).place(resources)


def _time_of(file: Path) -> datetime:
    return datetime.fromtimestamp(file.lstat().st_mtime).astimezone()


def _past_time(text: str) -> datetime:
    """Returns the time of a deadline.

    Raises:
        ConfigError: the text is not a date with a time of day, or the time is in the future.
    """
    try:
        deadline = datetime.fromisoformat(text).astimezone()
    except (ValueError, OverflowError):
        deadline = None
    if deadline is None or ":" not in text:
        raise ConfigError(
            f"--deadline is {text!r}, expected a time such as 2026-12-01T18:00, in the time zone "
            "of this machine, or with one, such as 2026-12-01T18:00+01:00"
        )
    if deadline > datetime.now().astimezone():
        raise ConfigError(
            f"--deadline {text} is in the future; run the tournament afterwards, or leave it out"
        )
    return deadline
