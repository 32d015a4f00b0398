"""A run's checkpoint: facts as JSON and tensors, in a file from which nothing is unpickled."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stkzoo._os import atomic_write

from .command import training_library

CHECKPOINT = "checkpoint.pt"


def save_checkpoint(folder: Path, facts: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Writes a run's checkpoint atomically.

    Args:
        folder: the run's.
        facts: JSON values.
        state: tensors and plain values by name, and dicts and lists of such.
    """
    with atomic_write(folder / CHECKPOINT) as part:
        training_library("torch").save({"facts": json.dumps(facts), **state}, part)


def load_checkpoint(folder: Path) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """Facts and state of a run's checkpoint; ``None`` if there is none."""
    if not (folder / CHECKPOINT).exists():
        return None
    state = training_library("torch").load(folder / CHECKPOINT, weights_only=True)
    return json.loads(state["facts"]), state
