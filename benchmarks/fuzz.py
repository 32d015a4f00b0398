"""Fuzzes all readers of untrusted input: messages, replays, agents, results and archives.

For any input, a reader must succeed or raise its own error, within limits: 1 s of CPU time, and
64 MiB of memory; for a message, 1 MiB plus 16 times its size. Anything else is a finding. The
command saves the finding and its input next to the results, and stops fuzzing that reader. With
atheris (`pip install atheris`), inputs are mutated to reach new lines of code; without it, they are
mutated at random. Counts are saved as the run proceeds, and the same command resumes an interrupted
run.

    python -m benchmarks.fuzz                          # 1,000,000 inputs, an hour
    python -m benchmarks.fuzz --inputs 20000 --readers replays results
    python -m benchmarks.fuzz --again benchmarks/results/robustness/finding-replays-1a2b3c
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from stkzoo._arguments import CommandParser
from stkzoo._os import write_text

RESULTS = Path(__file__).parent / "results" / "robustness" / "fuzz.json"
#: Relative numbers of inputs; fast readers get more.
SHARES = {
    "messages": 40,
    "results": 17,
    "plans": 12,
    "scenarios": 7,
    "replays": 6,
    "agent zips": 7,
    "keys": 6,
    "demonstrations": 2,
    "cards": 2,
    "asset archives": 1,
}
_CHUNK = 20_000
#: Maximum length of an input [bytes].
_MAX_LENGTH = 1 << 14
#: Time [s] and memory [MB] of an input at which atheris ends the process.
_PATIENCE, _MEMORY = 30, 3000
_COLUMNS = ("reader", "inputs", "findings", "how", "a second", "memory [MB]", "CPU [s]")
#: File with the maximum time and memory of an input.
_WORST = "worst.json"
_INSTRUMENTED = [
    "stkzoo.engine.assets.headless",
    "stkzoo.env.scenario",
    "stkzoo.race.document",
    "stkzoo.evaluation.batch.plan",
    "stkzoo.evaluation.benchmark",
    "stkzoo.drivers.messages",
    "stkzoo.race.replay.file",
    "stkzoo.race.result",
    "stkzoo.evaluation.tournament.plan",
    "stkzoo.drivers.files",
    "tarfile",
    "zipfile",
]


def main(argv: Sequence[str] | None = None) -> int:
    """Feeds the missing inputs and prints the table."""
    words = CommandParser(prog="python -m benchmarks.fuzz", description=__doc__)
    words.add_argument(
        "--inputs",
        type=int,
        default=1_000_000,
        metavar="N",
        help="total number of inputs (default: 1,000,000)",
    )
    words.add_argument("--readers", nargs="+", choices=SHARES, default=list(SHARES))
    words.add_argument("--plain", action="store_true", help="change inputs at random")
    words.add_argument("--output", type=Path, default=RESULTS, help="where the counts are kept")
    words.add_argument("--corpus", type=Path, help="where inputs are kept that reached new lines")
    words.add_argument("--again", type=Path, metavar="FINDING", help="feed a finding again")
    words.add_argument("--feed", nargs=4, help=argparse.SUPPRESS)
    arguments = words.parse_args(argv)
    if arguments.feed:
        reader, count, seed, corpus = arguments.feed
        return _feed(reader, int(count), int(seed), Path(corpus), arguments.plain)
    if arguments.again:
        return _again(arguments.again)
    plain = arguments.plain or importlib.util.find_spec("atheris") is None
    corpus = arguments.corpus or Path(tempfile.gettempdir()) / "stkzoo-fuzz-corpus"
    state = _read(arguments.output)
    shares = {name: SHARES[name] for name in arguments.readers}
    for name, share in shares.items():
        goal = arguments.inputs * share // sum(shares.values())
        _run_reader(name, goal, corpus, plain, arguments.output, state)
    _show(state)
    return 1 if any(row["findings"] for row in state.values()) else 0


def _read(file: Path) -> dict[str, Any]:
    if not file.exists():
        return {}
    readers: dict[str, Any] = json.loads(file.read_text())["readers"]
    return readers


def _run_reader(
    name: str, goal: int, corpus: Path, plain: bool, output: Path, state: dict[str, Any]
) -> None:
    row = state.setdefault(name, {"inputs": 0, "findings": [], "seconds": 0.0, "how": ""})
    worst = row.setdefault("worst", {"memory": 0, "seconds": 0.0})
    while row["inputs"] < goal and not row["findings"]:
        count = min(_CHUNK, goal - row["inputs"])
        begin = time.monotonic()
        seed = row["inputs"] + 1
        done, finding = _run_chunk(name, count, seed, corpus, plain, output.parent, worst)
        row["inputs"] += done
        row["seconds"] = round(row["seconds"] + time.monotonic() - begin, 1)
        row["how"] = "at random" if plain else "atheris"
        row["findings"] += [finding] if finding else []
        output.parent.mkdir(parents=True, exist_ok=True)
        write_text(output, json.dumps({"readers": state}, indent=2) + "\n")
        print(f"{name}: {row['inputs']} of {goal} inputs", file=sys.stderr)


def _run_chunk(
    name: str,
    count: int,
    seed: int,
    corpus: Path,
    plain: bool,
    folder: Path,
    worst: dict[str, float],
) -> tuple[int, dict[str, str] | None]:
    """Feeds a reader in a separate process; returns the number of inputs and any finding."""
    corpus = corpus / name.replace(" ", "-")
    (corpus / "found").mkdir(parents=True, exist_ok=True)
    (corpus / "found" / _WORST).unlink(missing_ok=True)
    words = [*(["--plain"] if plain else []), "--feed", name, str(count), str(seed), str(corpus)]
    command = [sys.executable, "-m", "benchmarks.fuzz", *words]
    done = subprocess.run(
        command, capture_output=True, text=True, errors="replace", check=False, env=_quiet()
    )
    if (corpus / "found" / _WORST).exists():
        found = json.loads((corpus / "found" / _WORST).read_text())
        worst.update({key: max(worst[key], value) for key, value in found.items()})
    if done.returncode == 0:
        return count, None
    files = [file for file in (corpus / "found").iterdir() if file.name != _WORST]
    crashes = sorted(files, key=lambda file: file.stat().st_mtime)
    told = re.findall(r"#(\d+)", done.stderr)
    finding = {"what": done.stderr[-2000:], "input": ""}
    if crashes:
        data = crashes[-1].read_bytes()
        kept = folder / f"finding-{name.replace(' ', '-')}-{hashlib.sha256(data).hexdigest()[:8]}"
        kept.write_bytes(data)
        finding["input"] = kept.name
    return int(told[-1]) if told else 0, finding


def _quiet() -> dict[str, str]:
    return {**os.environ, "PYTHONWARNINGS": "ignore"}


# ---------------------------------------------------------------------- the feeding process


class _Meter:
    """Feeds a target, and saves the maximum time and memory of an input.

    Args:
        target: the target.
        file: file for the maximum; written whenever it grows.
    """

    def __init__(self, target: Any, file: Path) -> None:
        from tests.chaos.cost import feed_measured

        self._feed, self._target, self._file = feed_measured, target, file
        self._worst = {"memory": 0.0, "seconds": 0.0}

    def feed(self, data: bytes) -> None:
        cost = self._feed(self._target, data)
        worst = self._worst
        if cost.memory > 1.1 * worst["memory"] or cost.seconds > 1.1 * worst["seconds"]:
            worst["memory"] = max(worst["memory"], cost.memory)
            worst["seconds"] = max(worst["seconds"], round(cost.seconds, 4))
            self._file.write_text(json.dumps(worst))


def _feed(name: str, count: int, seed: int, corpus: Path, plain: bool) -> int:
    if plain:
        return _feed_plain(name, count, seed, corpus)
    import atheris

    with atheris.instrument_imports(include=_INSTRUMENTED):
        from tests.chaos.targets import TARGETS
    target = TARGETS[name]
    for number, data in enumerate(target.seeds()):
        (corpus / f"seed-{number}").write_bytes(data)
    how = (
        f"-runs={count}",
        f"-seed={seed}",
        f"-max_len={_MAX_LENGTH}",
        f"-timeout={_PATIENCE}",
        f"-rss_limit_mb={_MEMORY}",
        f"-artifact_prefix={corpus}/found/",
    )
    meter = _Meter(target, corpus / "found" / _WORST)
    atheris.Setup([sys.argv[0], *how, str(corpus)], meter.feed)
    atheris.Fuzz()
    return 0


def _feed_plain(name: str, count: int, seed: int, corpus: Path) -> int:
    from tests.chaos.mutation import mutated
    from tests.chaos.targets import TARGETS

    target = TARGETS[name]
    inputs = mutated(random.Random(seed), target.seeds())
    meter = _Meter(target, corpus / "found" / _WORST)
    for number in range(count):
        data = next(inputs)
        try:
            meter.feed(data)
        except BaseException:
            (corpus / "found" / f"plain-{seed}-{number}").write_bytes(data)
            print(f"#{number}", file=sys.stderr)
            raise
    return 0


def _again(finding: Path) -> int:
    from tests.chaos.cost import feed_measured
    from tests.chaos.targets import TARGETS

    for name, target in TARGETS.items():
        if finding.name.startswith(f"finding-{name.replace(' ', '-')}-"):
            feed_measured(target, finding.read_bytes())
            print(f"{name}: no problem")
            return 0
    print(f"{finding.name} does not name a reader", file=sys.stderr)
    return 2


def _show(state: Mapping[str, Any]) -> None:
    table = Table(box=box.SIMPLE)
    for name in _COLUMNS:
        is_text = name in ("reader", "how")
        table.add_column(name, justify="left" if is_text else "right", no_wrap=True)
    for name, row in state.items():
        speed = row["inputs"] / row["seconds"] if row["seconds"] else 0.0
        counts = (f"{row['inputs']:,}", str(len(row["findings"])))
        worst = row.get("worst", {"memory": 0, "seconds": 0})
        most = (f"{worst['memory'] / 2**20:.2f}", f"{worst['seconds']:.3f}")
        table.add_row(name, *counts, row["how"], f"{speed:.0f}", *most)
    table.add_row("all", f"{sum(row['inputs'] for row in state.values()):,}")
    Console(width=120).print(table)
    for name, row in state.items():
        for finding in row["findings"]:
            print(f"{name} {finding['input']}:\n{finding['what']}")


if __name__ == "__main__":
    sys.exit(main())
