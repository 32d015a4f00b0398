"""Injects thousands of faults: kills and stops processes at random moments.

Each fault has a number, and is determined by it and the seed. A separate program injects a hundred
faults at a time, next to a race that must not be affected. Faults of whole programs are injected
from outside. Each result is written immediately, and the same command resumes an interrupted run.

    python -m benchmarks.chaos                        # 1,000 faults that hit, 40 minutes
    python -m benchmarks.chaos --faults 50 --seed 7   # fewer and different faults
    python -m benchmarks.chaos --only 137             # repeat one fault, with all its output
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import count, islice
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.common import RESULTS, progress_bar, read_rows
from stkzoo._arguments import CommandParser
from tests.chaos.family import marked
from tests.chaos.forms import FORMS
from tests.chaos.plan import fault_of
from tests.chaos.programs import ProgramTrials
from tests.chaos.trial import Outcome, Trials
from tests.support.processes import wait_until

OUTPUT = RESULTS / "robustness" / "faults.jsonl"
_BATCH = 100
#: Time without a result after which a batch counts as hung [s].
_PATIENCE = 400.0
_SETTLE = 15.0  # [s]


def main(argv: Sequence[str] | None = None) -> int:
    """Injects the missing faults and prints the table."""
    words = CommandParser(prog="python -m benchmarks.chaos", description=__doc__)
    words.add_argument("--faults", type=int, default=1000, metavar="N", help="faults that hit")
    words.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the faults")
    words.add_argument("--output", type=Path, default=OUTPUT, help="JSON lines file")
    words.add_argument("--only", type=int, metavar="N", help="inject fault number N and stop")
    words.add_argument("--batch", type=int, nargs="+", help=argparse.SUPPRESS)
    arguments = words.parse_args(argv)
    if arguments.only is not None:
        return _inject([arguments.only], arguments.seed, None)
    if arguments.batch:
        return _inject(arguments.batch, arguments.seed, arguments.output)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    rows = read_rows(arguments.output)
    with progress_bar(arguments.faults) as (progress, task):
        while (missing := arguments.faults - _num_hits(rows)) > 0:
            progress.update(task, completed=_num_hits(rows))
            done = {row["number"] for row in rows}
            undone = (number for number in count() if number not in done)
            batch = list(islice(undone, min(_BATCH, missing)))
            _run_batch(batch, arguments.seed, arguments.output)
            rows = read_rows(arguments.output)
        progress.update(task, completed=_num_hits(rows))
    _show(rows)
    return 1 if any(not row["survived"] for row in rows) else 0


def _num_hits(rows: Sequence[Mapping[str, Any]]) -> int:
    return sum(row["injected"] for row in rows)


# ---------------------------------------------------------------------- the process of a batch


def _inject(numbers: Sequence[int], seed: int, output: Path | None) -> int:
    faults = {number: fault_of(seed, number) for number in numbers}
    with ProgramTrials() as outside, Trials() as inside:
        for number, fault in faults.items():
            outcome = (inside if fault.form in FORMS else outside).run(fault)
            line = json.dumps(_as_row(number, outcome))
            if output is None:
                print(line)
                print(outcome.problem)
            else:
                with output.open("a") as file:
                    file.write(line + "\n")
    return 0


def _as_row(number: int, outcome: Outcome) -> dict[str, Any]:
    form = outcome.to_form()
    fault = form.pop("fault")
    del fault["share"], fault["choice"]
    form["seconds"] = round(form["seconds"], 2)
    return {"number": number, **fault, **form}


# ---------------------------------------------------------------------- supervision of a batch


def _run_batch(numbers: Sequence[int], seed: int, output: Path) -> None:
    """Runs a batch in a separate process; records a loss if the process hangs or dies."""
    mark = uuid.uuid4().hex
    command = [sys.executable, "-X", "faulthandler", "-m", "benchmarks.chaos"]
    how = ["--seed", str(seed), "--output", str(output), "--batch", *map(str, numbers)]
    program = subprocess.Popen(
        [*command, *how],
        env={**os.environ, "STKZOO_CHAOS_BATCH": mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    problem = _watch(program, output)
    said = program.communicate()[1]
    rest = lambda: marked(mark)  # noqa: E731
    if not problem and not wait_until(lambda: not rest(), _SETTLE):
        problem = f"processes remain after the batch: {rest()}"
    if not problem and program.returncode:
        problem = f"the program of the faults ended with {program.returncode}: {said[-3000:]}"
    for pid in rest():
        os.kill(pid, signal.SIGKILL)
    if problem:
        _add_loss(numbers, seed, output, problem)


def _watch(program: subprocess.Popen[str], output: Path) -> str:
    """Waits for the end; returns a description of the problem if the output stops growing."""
    size, since = -1, time.monotonic()
    while program.poll() is None:
        now = output.stat().st_size if output.exists() else 0
        if now != size:
            size, since = now, time.monotonic()
        if time.monotonic() - since > _PATIENCE:
            program.send_signal(signal.SIGABRT)  # faulthandler prints where it hangs
            return f"it hung for {_PATIENCE:.0f} s"
        time.sleep(0.2)
    return ""


def _add_loss(numbers: Sequence[int], seed: int, output: Path, problem: str) -> None:
    done = {row["number"] for row in read_rows(output)}
    left = [number for number in numbers if number not in done] or [numbers[-1]]
    lost = Outcome(fault_of(seed, left[0]), True, False, "", _PATIENCE, 0, problem)
    with output.open("a") as file:
        file.write(json.dumps(_as_row(left[0], lost)) + "\n")


# ---------------------------------------------------------------------- the table


def _show(rows: Sequence[Mapping[str, Any]]) -> None:
    table = Table(box=box.SIMPLE)
    for name in ("form", "injected", "survived", "lost", "said", "longest [s]"):
        table.add_column(name, justify="left" if name in ("form", "said") else "right")
    for form in [*sorted({row["form"] for row in rows}), ""]:
        hits = [row for row in rows if row["injected"] and form in ("", row["form"])]
        lost = [row for row in rows if not row["survived"] and form in ("", row["form"])]
        said = Counter(row["answer"] for row in hits).most_common(4)
        table.add_row(
            form or "all",
            str(len(hits)),
            str(len(hits) - len(lost)),
            str(len(lost)),
            ", ".join(f"{answer} {count}" for answer, count in said),
            f"{max((row['seconds'] for row in hits), default=0):.1f}",
        )
    Console(width=160).print(table)
    for row in rows:
        if not row["survived"]:
            print(f"fault {row['number']}: {row}")


if __name__ == "__main__":
    sys.exit(main())
