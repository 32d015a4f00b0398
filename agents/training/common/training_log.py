"""The log of a run: a line an iteration as JSON, and TensorBoard's files if that is installed."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stkzoo._os import atomic_write
from stkzoo.errors import ConfigError

__all__ = ["LOG", "Journal", "log_of_run", "read_log", "write_log"]

#: The log's file in a run's folder.
LOG = "log.jsonl"


def read_log(folder: Path) -> list[dict[str, Any]]:
    """The lines of a run's log; none if there is no log yet."""
    file = folder / LOG
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def log_of_run(folder: str | Path) -> list[dict[str, Any]]:
    """The lines of the log of a run that there must be.

    Raises:
        ConfigError: there is none.
    """
    if not (Path(folder) / LOG).is_file():
        raise ConfigError(f"{str(folder)!r} is no run's folder: it has no {LOG}")
    return read_log(Path(folder))


def write_log(folder: Path, log: Sequence[Mapping[str, Any]]) -> None:
    """Writes all of a run's log, whole or not at all."""
    with atomic_write(folder / LOG) as part:
        part.write_text("".join(json.dumps(dict(line)) + "\n" for line in log))


class Journal:
    """The log of a run that may go on from a checkpoint: what came after that is taken out.

    Args:
        folder: the run's.
        iteration: the last one that counts.

    Attributes:
        last: the last line; empty at the beginning.
    """

    def __init__(self, folder: Path, iteration: int) -> None:
        self._file = folder / LOG
        kept = [line for line in read_log(folder) if line["iteration"] <= iteration]
        write_log(folder, kept)
        self.last: dict[str, Any] = kept[-1] if kept else {}
        self._writer: Any = None
        try:
            board = importlib.import_module("torch.utils.tensorboard")
        except ImportError:
            return
        self._writer = board.SummaryWriter(folder, purge_step=self.last.get("kart_steps", 0) + 1)

    def write(self, line: Mapping[str, Any]) -> None:
        """Adds an iteration's figures, ``iteration`` and ``kart_steps`` among them.

        One that is None is not known: TensorBoard's files lack it.
        """
        with self._file.open("a") as log:
            log.write(json.dumps(dict(line)) + "\n")
        for name, value in line.items():
            if value is not None:
                self.add(name, value, int(line["kart_steps"]))

    def add(self, name: str, value: float, kart_steps: int) -> None:
        """Adds a figure to TensorBoard's files alone."""
        if self._writer is not None:
            self._writer.add_scalar(name, value, kart_steps)

    def close(self) -> None:
        """Writes what is left."""
        if self._writer is not None:
            self._writer.close()
