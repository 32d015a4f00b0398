"""The files of a run: arguments, checkpoint and log.

The log has one JSON line per iteration, and TensorBoard files if that is installed. A checkpoint
contains facts as JSON, and tensors in a file that is read without unpickling.
"""

from __future__ import annotations

import importlib
import io
import json
import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from stkzoo._locks import LOCK
from stkzoo._os import make_folder, write_text, write_whole, writing
from stkzoo._reading import load_json, open_zip, read_json, read_lines, reading
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.errors import ConfigError

from .command import training_library

#: The files in a run's folder.
ARGUMENTS, CHECKPOINT, LOG = "arguments.json", "checkpoint.pt", "log.jsonl"
#: State of a league, in its folder.
LEAGUE = "league.json"

#: Largest size of a file of a run, and of a checkpoint [bytes].
_MAX_BYTES, _MAX_CHECKPOINT = 64 << 20, 4 << 30

#: Number of digits of the kart-steps in the name of a policy, at least.
_DIGITS = 9

T = TypeVar("T")


def read_run_file(content_type: type[T], file: Path) -> T:
    """Returns the content of a JSON file in a run's folder.

    Args:
        content_type: type of the content; see :func:`stkzoo._reading.read_json`.
        file: the file.

    Raises:
        ConfigError: the file is missing or damaged.
    """
    with reading(f"{str(file)!r} cannot be read", "the file that the run wrote"):
        return load_json(file, content_type, _MAX_BYTES)


# ---------------------------------------------------------------------- arguments


def write_json(path: Path, content: Any) -> None:
    """Writes a JSON file atomically."""
    write_text(path, json.dumps(content, indent=1) + "\n")


def check_resumed(folder: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Checks that a run continues with its original arguments.

    Args:
        folder: folder of the run.
        before: arguments in its files.
        now: given arguments.

    Raises:
        ConfigError: the arguments differ, or another version of stkzoo wrote the files.
    """
    if set(before) != set(now):
        raise ConfigError(
            f"the run in {str(folder)!r} is from another version of stkzoo, with different "
            "arguments; give another --output (and --init with its newest policy to start from it)"
        )
    arguments = json.loads(json.dumps(now))
    changed = [
        f"{n} was {before[n]!r}, now {arguments[n]!r}"
        for n in arguments
        if before[n] != arguments[n]
    ]
    if changed:
        raise ConfigError(
            f"the run in {str(folder)!r} has other arguments: {', '.join(changed)}; give the same, "
            "or another --output; --init, where available, starts from this run's weights"
        )


def keep_arguments(folder: Path, arguments: Any, free: Collection[str] = ()) -> None:
    """Writes the arguments of a new run, or checks those of a continued one.

    A run that ended before it wrote anything else, perhaps because an argument was wrong, is new.

    Args:
        folder: folder of the run; created if necessary.
        arguments: a dataclass.
        free: fields that may change when a run continues; they are not written.

    Raises:
        ConfigError: see :func:`check_resumed`; or the folder cannot be created.
    """
    now = {name: value for name, value in asdict(arguments).items() if name not in free}
    file = folder / ARGUMENTS
    if file.exists() and {path.name for path in folder.iterdir()} - {ARGUMENTS, LOCK}:
        check_resumed(folder, read_run_file(dict[str, Any], file), now)
        return
    make_folder(folder, "run")
    write_json(file, now)


# ---------------------------------------------------------------------- plan parameters


def plan_parameters(file: str | Path) -> DriverParameters:
    """Reads plan parameters from a file with an object of them, or from a run's arguments.

    Args:
        file: path of the file; empty for the default parameters.

    Raises:
        ConfigError: the file is unreadable, or has unknown parameters.
    """
    if not file:
        return DriverParameters()
    with reading(f"{str(file)!r} has no parameters of plans", "an object, or an arguments.json"):
        content: Any = load_json(file, Any)
        if isinstance(content, list):
            content = content[-1]["rules"]
        return DriverParameters.from_json(content)


def policy_name(kart_steps: int) -> str:
    """Returns the name of a run's policy after a number of kart-steps."""
    return f"policy-{kart_steps:0{_DIGITS}d}"


def kart_steps_of(policy: Path) -> int | None:
    """Returns the kart-steps of a file that :func:`policy_name` names; ``None`` for others."""
    digits = policy.stem.removeprefix("policy-")
    is_round = len(digits) < _DIGITS  # imitation numbers its rounds
    return int(digits) if digits.isdigit() and not is_round else None


def saved_policies(folder: Path) -> list[Path]:
    """Returns the files of the policies in the folder of a run, the first one first."""
    return sorted(folder.glob("policy-*.safetensors"))


def remove_later_policies(folder: Path, kart_steps: int) -> None:
    """Removes the policies that a run saved after its checkpoint, before it was interrupted.

    The run continues from its checkpoint and learns other policies.

    Args:
        folder: folder of the run.
        kart_steps: kart-steps of the checkpoint.
    """
    for policy in saved_policies(folder):
        if (kart_steps_of(policy) or 0) > kart_steps:
            policy.unlink()


def run_parameters(policy: Path) -> DriverParameters:
    """Returns the plan parameters with which a policy learned; the defaults without a run.

    Args:
        policy: policy file in the folder of its run.

    Raises:
        ConfigError: the run is from another version.
    """
    file = policy.with_name(ARGUMENTS)
    return plan_parameters(file if file.exists() else "")


# ---------------------------------------------------------------------- checkpoint


def save_checkpoint(folder: Path, facts: Mapping[str, Any], state: Mapping[str, Any]) -> None:
    """Writes a run's checkpoint atomically.

    Args:
        folder: folder of the run.
        facts: JSON values.
        state: tensors and plain values by name, and dicts and lists of these.

    Raises:
        ConfigError: the file cannot be written.
    """
    content = io.BytesIO()  # PyTorch's errors about files do not say what is wrong
    training_library("torch").save({"facts": json.dumps(facts), **state}, content)
    with write_whole(folder / CHECKPOINT, "the checkpoint") as part:
        part.write_bytes(content.getbuffer())


def load_checkpoint(folder: Path, facts_type: type[T]) -> tuple[T, dict[str, Any]] | None:
    """Returns facts and state of a run's checkpoint; ``None`` without a checkpoint.

    Args:
        folder: folder of the run.
        facts_type: type of the facts.

    Raises:
        ConfigError: the checkpoint is damaged.
    """
    file = folder / CHECKPOINT
    if not os.path.lexists(file):
        return None
    with reading_checkpoint(folder):
        with open_zip(file, 100_000, _MAX_CHECKPOINT):
            pass  # the list of its members is valid
        state = training_library("torch").load(file, weights_only=True, map_location="cpu")
        return read_json(state["facts"], facts_type, _MAX_BYTES), state


def reading_checkpoint(folder: Path) -> AbstractContextManager[None]:
    """Explains the errors of a block that uses a run's checkpoint."""
    what = f"the checkpoint {str(folder / CHECKPOINT)!r} cannot be read"
    return reading(what, "the file that the run wrote; give another --output to start again")


# ---------------------------------------------------------------------- log


def _json_line(line: Mapping[str, Any]) -> str:
    """Returns a line of a log. JSON has no infinite numbers and no NaN; they become null."""
    return msgspec.json.encode(line).decode() + "\n"


def read_log(folder: Path) -> list[dict[str, Any]]:
    """Returns the lines of a run's log; empty if there is no log.

    An incomplete last line is left out.

    Raises:
        ConfigError: the log is damaged.
    """
    file = folder / LOG
    if not os.path.lexists(file):
        return []
    with reading(f"{str(file)!r} cannot be read", "the lines that the run wrote"):
        return read_lines(file, dict[str, Any], _MAX_BYTES)


def write_log(folder: Path, log: Sequence[Mapping[str, Any]]) -> None:
    """Writes the whole log of a run atomically."""
    write_text(folder / LOG, "".join(map(_json_line, log)))


class TrainingLog:
    """The log of a run; when a run continues, entries after its checkpoint are removed.

    Args:
        folder: folder of the run.
        iteration: iteration of the checkpoint.

    Attributes:
        last: latest entry; empty at the beginning.
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

    def __enter__(self) -> TrainingLog:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def write(self, line: Mapping[str, Any]) -> None:
        """Adds an entry for an iteration, which must include ``iteration`` and ``kart_steps``.

        TensorBoard gets all figures except those that are ``None``.

        Raises:
            ConfigError: the log cannot be written.
        """
        with writing(self._file, "the log"), self._file.open("a") as log:
            log.write(_json_line(line))
        for name, value in line.items():
            if self._writer is not None and value is not None:
                self._writer.add_scalar(name, value, int(line["kart_steps"]))
