"""New interpreters to play in, and the processes that an environment has started."""

from __future__ import annotations

import os
import pickle
import subprocess
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cloudpickle  # type: ignore[import-untyped]

from stkzoo._python import python_command, search_path
from stkzoo.checks.play import NotApplicable, expect

_TIMEOUT = 600.0
_CHILD = "import sys; from stkzoo.checks.processes import main; main(sys.argv[1])"


def run_fresh(function: Callable[..., Any], *arguments: Any) -> tuple[Any, str]:
    """Calls a function in a new interpreter with another hash seed.

    Args:
        function: the function; it is sent by cloudpickle, as are its arguments.
        *arguments: its arguments.

    Returns:
        The function's result, and the output on the standard streams.

    Raises:
        CheckFailed: the function raised.
    """
    with tempfile.TemporaryDirectory(prefix="stkzoo-check-") as folder:
        Path(folder, "call").write_bytes(cloudpickle.dumps((function, arguments)))
        run = subprocess.run(  # noqa: S603 - our own interpreter on our own code
            python_command(_CHILD, folder),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=_environment(),
            timeout=_TIMEOUT,
            check=False,
        )
        output = run.stdout.decode(errors="replace").strip()
        answer = Path(folder, "answer")
        expect(
            run.returncode == 0 and answer.exists(),
            f"a fresh process ended with code {run.returncode}: {output}",
        )
        succeeded, result = pickle.loads(answer.read_bytes())  # noqa: S301 - written below
    expect(succeeded, f"in a fresh process: {result}")
    return result, output


def main(folder: str) -> None:
    """Runs the function in the new interpreter; see :func:`run_fresh`."""
    function, arguments = pickle.loads(Path(folder, "call").read_bytes())  # noqa: S301
    try:
        answer = True, function(*arguments)
    except Exception:  # noqa: BLE001 - it is the caller who must hear of it
        answer = False, traceback.format_exc()
    Path(folder, "answer").write_bytes(pickle.dumps(answer))


def descendants() -> frozenset[int]:
    """Returns the ids of all living descendants of this process.

    Raises:
        NotApplicable: the system does not report them.
    """
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            status = Path(folder, "stat").read_text(errors="replace")
        except OSError:  # the process has ended
            continue
        state, parent = status.rpartition(")")[2].split()[:2]
        if state not in "ZX":
            parents[int(folder.name)] = int(parent)
    if os.getpid() not in parents:
        raise NotApplicable("this system has no /proc to list processes")
    found: set[int] = set()
    while (
        new := {pid for pid, parent in parents.items() if parent in {os.getpid(), *found}} - found
    ):
        found |= new
    return frozenset(found)


def _environment() -> dict[str, str]:
    path = os.pathsep.join(search_path())
    return {**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "1"}
