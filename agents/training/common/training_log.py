"""The log of a run: one JSON line per iteration, and TensorBoard files if that is installed."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stkzoo._os import write_text
from stkzoo.errors import ConfigError

#: The log's file in a run's folder.
LOG = "log.jsonl"


def read_json_lines(file: Path) -> list[dict[str, Any]]:
    """The lines of a file of JSON lines; none if there is no such file."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def require_log(folder: str | Path) -> list[dict[str, Any]]:
    """The lines of a run's log.

    Raises:
        ConfigError: the folder has none.
    """
    file = Path(folder) / LOG
    if not file.is_file():
        raise ConfigError(f"{str(folder)!r} is not the folder of a run: it has no {LOG}")
    return read_json_lines(file)


def write_log(folder: Path, log: Sequence[Mapping[str, Any]]) -> None:
    """Writes the whole log of a run atomically."""
    write_text(folder / LOG, "".join(json.dumps(dict(line)) + "\n" for line in log))


class TrainingLog:
    """The log of a run that may continue from a checkpoint; later lines are removed.

    Args:
        folder: the run's.
        iteration: that of the checkpoint.

    Attributes:
        last: the last line; empty at the beginning.
    """

    def __init__(self, folder: Path, iteration: int) -> None:
        self._file = folder / LOG
        kept = [line for line in read_json_lines(self._file) if line["iteration"] <= iteration]
        write_log(folder, kept)
        self.last: dict[str, Any] = kept[-1] if kept else {}
        self._writer: Any = None
        try:
            board = importlib.import_module("torch.utils.tensorboard")
        except ImportError:
            return
        self._writer = board.SummaryWriter(folder, purge_step=self.last.get("kart_steps", 0) + 1)

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def write(self, line: Mapping[str, Any]) -> None:
        """Adds an iteration's figures, with ``iteration`` and ``kart_steps`` among them.

        TensorBoard gets all figures but those that are ``None``.
        """
        with self._file.open("a") as log:
            log.write(json.dumps(dict(line)) + "\n")
        for name, value in line.items():
            if value is not None:
                self.add(name, value, int(line["kart_steps"]))

    def add(self, name: str, value: float, kart_steps: int) -> None:
        """Adds a figure to the TensorBoard files alone."""
        if self._writer is not None:
            self._writer.add_scalar(name, value, kart_steps)
