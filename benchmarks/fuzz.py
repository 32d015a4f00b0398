"""Fuzzes every reader of what comes from outside: messages, replays, agents, results, archives.

Whatever the bytes, a reader may end well or with its own error; anything else is a finding, is
kept beside the results with the bytes that did it, and ends the run of that reader. atheris
(`pip install atheris`) looks for inputs that reach new lines; without it, inputs are changed
at random. Counts are kept as they come, and the same command goes on where it was.

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

from stkzoo._os import atomic_write

RESULTS = Path(__file__).parent / "results" / "robustness" / "fuzz.json"
#: How the inputs are shared out: the quick readers get more.
SHARES = {
    "messages": 40,
    "results": 20,
    "plans": 15,
    "scenarios": 8,
    "replays": 8,
    "agent zips": 8,
    "asset archives": 1,
}
_CHUNK = 20_000
#: Longer inputs than this are not made [bytes].
_MAX_LENGTH = 1 << 14
#: Seconds and megabytes that one input may take.
_PATIENCE, _MEMORY = 30, 3000
_INSTRUMENTED = [
    "stkzoo.engine.assets.headless",
    "stkzoo.env.scenario",
    "stkzoo.race.document",
    "stkzoo.evaluation.batch.plan",
    "stkzoo.evaluation.benchmark",
    "stkzoo.drivers.codec",
    "stkzoo.race.replay.file",
    "stkzoo.race.result",
    "stkzoo.evaluation.tournament.plan",
    "stkzoo.drivers.files",
    "tarfile",
    "zipfile",
]


def main(argv: Sequence[str] | None = None) -> int:
    """Feeds what is missing and shows the table."""
    words = argparse.ArgumentParser(
        prog="python -m benchmarks.fuzz",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    words.add_argument("--inputs", type=int, default=1_000_000, metavar="N", help="in all")
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
    while row["inputs"] < goal and not row["findings"]:
        count = min(_CHUNK, goal - row["inputs"])
        begin = time.monotonic()
        seed = row["inputs"] + 1
        done, finding = _run_chunk(name, count, seed, corpus, plain, output.parent)
        row["inputs"] += done
        row["seconds"] = round(row["seconds"] + time.monotonic() - begin, 1)
        row["how"] = "at random" if plain else "atheris"
        row["findings"] += [finding] if finding else []
        output.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(output) as part:
            part.write_text(json.dumps({"readers": state}, indent=2) + "\n")
        print(f"{name}: {row['inputs']} of {goal} inputs", file=sys.stderr)


def _run_chunk(
    name: str, count: int, seed: int, corpus: Path, plain: bool, folder: Path
) -> tuple[int, dict[str, str] | None]:
    """Feeds a reader in a process of its own; how many inputs it took, and what was found."""
    corpus = corpus / name.replace(" ", "-")
    (corpus / "found").mkdir(parents=True, exist_ok=True)
    words = [*(["--plain"] if plain else []), "--feed", name, str(count), str(seed), str(corpus)]
    command = [sys.executable, "-m", "benchmarks.fuzz", *words]
    done = subprocess.run(  # noqa: S603 - this module itself
        command, capture_output=True, text=True, errors="replace", check=False, env=_quiet()
    )
    if done.returncode == 0:
        return count, None
    crashes = sorted((corpus / "found").glob("*"), key=lambda file: file.stat().st_mtime)
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


# ---------------------------------------------------------------------- in the process that feeds


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
    atheris.Setup([sys.argv[0], *how, str(corpus)], target.feed)
    atheris.Fuzz()
    return 0


def _feed_plain(name: str, count: int, seed: int, corpus: Path) -> int:
    from tests.chaos.mutation import mutated
    from tests.chaos.targets import TARGETS

    target = TARGETS[name]
    inputs = mutated(random.Random(seed), target.seeds())
    for number in range(count):
        data = next(inputs)
        try:
            target.feed(data)
        except BaseException:
            (corpus / "found" / f"plain-{seed}-{number}").write_bytes(data)
            print(f"#{number}", file=sys.stderr)
            raise
    return 0


def _again(finding: Path) -> int:
    from tests.chaos.targets import TARGETS

    for name, target in TARGETS.items():
        if finding.name.startswith(f"finding-{name.replace(' ', '-')}-"):
            target.feed(finding.read_bytes())
            print(f"{name}: all is well")
            return 0
    print(f"{finding.name} is of no reader", file=sys.stderr)
    return 2


def _show(state: Mapping[str, Any]) -> None:
    table = Table(box=box.SIMPLE)
    for name in ("reader", "inputs", "findings", "how", "a second"):
        table.add_column(name, justify="left" if name in ("reader", "how") else "right")
    for name, row in state.items():
        speed = row["inputs"] / row["seconds"] if row["seconds"] else 0.0
        counts = (f"{row['inputs']:,}", str(len(row["findings"])))
        table.add_row(name, *counts, row["how"], f"{speed:.0f}")
    table.add_row("all", f"{sum(row['inputs'] for row in state.values()):,}", "", "", "")
    Console(width=120).print(table)
    for name, row in state.items():
        for finding in row["findings"]:
            print(f"{name} {finding['input']}:\n{finding['what']}")


if __name__ == "__main__":
    sys.exit(main())
