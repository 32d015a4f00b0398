"""The log of a run: a line an iteration as JSON, and TensorBoard's files if that is installed."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stkzoo.whole_file import whole_file

__all__ = ["LOG", "Journal"]

#: The log's file in a run's folder.
LOG = "log.jsonl"


class Journal:
    """The log of a run that may go on from a checkpoint: what came after that is taken out.

    Args:
        folder: the run's.
        iteration: the last one that counts.
        kart_steps: how many there had been then.
    """

    def __init__(self, folder: Path, iteration: int, kart_steps: int) -> None:
        self._file = folder / LOG
        old = self._file.read_text().splitlines() if self._file.exists() else []
        kept = [line for line in old if json.loads(line)["iteration"] <= iteration]
        with whole_file(self._file) as part:
            part.write_text("".join(f"{line}\n" for line in kept))
        self._writer: Any = None
        try:
            board = importlib.import_module("torch.utils.tensorboard")
        except ImportError:
            return
        self._writer = board.SummaryWriter(folder, purge_step=kart_steps + 1)

    def write(self, line: Mapping[str, float]) -> None:
        """Adds an iteration's figures, ``iteration`` and ``kart_steps`` among them."""
        with self._file.open("a") as log:
            log.write(json.dumps(dict(line)) + "\n")
        for name, value in line.items():
            self.add(name, value, int(line["kart_steps"]))

    def add(self, name: str, value: float, kart_steps: int) -> None:
        """Adds a figure to TensorBoard's files alone."""
        if self._writer is not None:
            self._writer.add_scalar(name, value, kart_steps)

    def close(self) -> None:
        """Writes what is left."""
        if self._writer is not None:
            self._writer.close()
