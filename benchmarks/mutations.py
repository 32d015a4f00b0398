"""Damages files of every kind that stkzoo reads; each must be read or raise stkzoo's own error.

Changes of a JSON file: a value of another type, a number out of range or not finite, a huge or
deeply nested value, a missing, repeated or renamed entry, or a truncated file. Arrays and zip files
are damaged in their parts.

    python -m benchmarks.mutations                       # 10,000 of each kind, half an hour
    python -m benchmarks.mutations --mutations 500 --kinds race-result league
"""

from __future__ import annotations

import copy
import random
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.bench_common import Table, print_tables
from benchmarks.mutation_kinds import KINDS, FileKind
from stkzoo._arguments import CommandParser
from stkzoo.errors import StkzooError

#: Replacements for a value.
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, -5, 2**31, 2**63, -(2**63), 10**400, 0.5, -0.0, 1e308, -1e308),
    *(float("nan"), float("inf"), -float("inf")),
    *("", "first", "soon", "\x1b[2J", "\ud800", "../../x", "a" * 10_000, "0", "é"),
    *([], {}, [[]], [None], {"": 0}, [0] * 1000, {str(n): n for n in range(1000)}),
)
_DEPTH = 100_000
_MAX_SHOWN = 3
_COLUMNS = ("kind", "mutations", "refused", "read", "bare errors", "slowest", "a second")


@dataclass(slots=True)
class Outcome:
    """Outcome of reading damaged files of one kind.

    Attributes:
        refused: number of files that raised stkzoo's own error.
        read: number of files that were read.
        slowest: longest time of a file [s].
        findings: mutation and traceback of each other error.
    """

    refused: int = 0
    read: int = 0
    slowest: float = 0.0
    findings: list[str] | None = None


def mutate(value: Any, source: random.Random) -> Any:
    """Returns a copy of a JSON value with one or two random changes."""
    changed = {"root": copy.deepcopy(value)}
    for _ in range(source.choice((1, 1, 1, 2))):
        holder, key = source.choice(list(_places(changed)))
        _change(holder, key, source)
    return changed.get("root")


def _places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yields each container in a value with each of its keys."""
    keys = list(value) if isinstance(value, dict) else range(len(value))
    for key in keys:
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from _places(value[key])


def _change(holder: Any, key: Any, source: random.Random) -> None:
    present = holder[key]
    how = source.random()
    if how < 0.6:
        holder[key] = copy.deepcopy(source.choice(VALUES))
    elif how < 0.7 and isinstance(present, (int, float)):
        holder[key] = present * source.choice((-1, 2, 1000)) + source.choice((-1, 0, 1))
    elif how < 0.8 and key != "root":
        del holder[key]
    elif how < 0.9 and isinstance(present, list) and present:
        holder[key] = source.choice((present * 2, present[:-1], present[::-1], [present]))
    elif isinstance(holder, dict) and key != "root":
        holder[source.choice(("x", key.upper(), f"{key}\x00"))] = holder.pop(key)
    else:
        holder[key] = [present]


def damaged_text(text: str, source: random.Random) -> bytes:
    """Returns a damaged copy of a text, regardless of its structure."""
    data = text.encode("utf-8", "surrogatepass")
    place = source.randrange(len(data) + 1)
    return source.choice(
        (
            data[:place],
            data[:place] + bytes([source.randrange(256)]) + data[place + 1 :],
            data[:place] + data[place // 2 :],
            text.encode("utf-16"),
            b"\xef\xbb\xbf" + data,
            data[:place] + b"[" * _DEPTH,
            data[:place] + b'{"a":' * _DEPTH,
            data[:place] + b"9" * 10_000 + data[place:],
        )
    )


def run_kind(kind: FileKind, count: int, seed: int, folder: Path) -> Outcome:
    """Reads damaged files of a kind.

    Args:
        kind: the kind.
        count: number of files.
        seed: seed of the damage.
        folder: empty folder for the files.
    """
    source, outcome, findings = random.Random(f"{seed} {kind.name}"), Outcome(), []
    kind.read(kind.write(folder, kind.valid()))  # a valid file must be readable
    for number in range(count):
        file = kind.damage(folder, source, mutate, damaged_text)
        begin = time.perf_counter()
        try:
            kind.read(file)
            outcome.read += 1
        except StkzooError:
            outcome.refused += 1
        except Exception:  # noqa: BLE001 - any other error is a finding
            findings.append(f"{kind.name}, mutation {number}:\n{traceback.format_exc()[-1500:]}")
        outcome.slowest = max(outcome.slowest, time.perf_counter() - begin)
    outcome.findings = findings
    return outcome


def main(argv: Sequence[str] | None = None) -> int:
    """Damages and reads files, and prints a table."""
    parser = CommandParser(prog="python -m benchmarks.mutations", description=__doc__)
    parser.add_argument("--mutations", type=int, default=10_000, metavar="N", help="of each kind")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    rows: list[tuple[str, ...]] = []
    found: list[str] = []
    for name in arguments.kinds:
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            outcome = run_kind(KINDS[name], arguments.mutations, arguments.seed, Path(folder))
        own = outcome.findings or []
        speed = arguments.mutations / (time.perf_counter() - begin)
        counts = (arguments.mutations, outcome.refused, outcome.read, len(own))
        times = (f"{outcome.slowest * 1e3:.0f} ms", f"{speed:.0f}")
        rows.append((name, *(f"{number:,}" for number in counts), *times))
        found += own[:_MAX_SHOWN]
        print(f"{name}: {len(own)} bare errors", file=sys.stderr, flush=True)
    print_tables([Table("damaged files", _COLUMNS, rows)])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    print(f"peak memory of the process: {peak} MB")
    print("\n".join(found))
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
