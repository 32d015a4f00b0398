"""Shared parts of the benchmark commands: arguments, figures, host facts, tables, files."""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import statistics
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import rich.table
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

import stkzoo.views
from benchmarks.bench_driver import Times
from stkzoo._arguments import CommandParser
from stkzoo.tracks import SPLITS

__all__ = [
    "KARTS",
    "REFERENCE_VIEWS",
    "RESULTS",
    "VIEWS",
    "Table",
    "add_driving",
    "cores",
    "figures",
    "host_facts",
    "parser",
    "print_tables",
    "progress_bar",
    "quantiles",
    "read_rows",
    "save",
    "spread",
]

RESULTS = Path(__file__).parent / "results"
KARTS = (1, 3, 10, 20)
#: Views that pystk2-gymnasium also has.
REFERENCE_VIEWS = ("full", "simple", "flattened", "flattened_discrete")
#: All views without camera images, those of the reference first.
VIEWS = tuple(sorted(stkzoo.views.VIEWS, key=lambda view: view not in REFERENCE_VIEWS))

#: Minimum width of tables, even if the terminal is narrower.
_TABLE_WIDTH = 200
_PACKAGES = ("stkzoo", "PySuperTuxKart2", "pystk2-gymnasium", "numpy", "numba", "gymnasium")


def parser(
    doc: str | None,
    name: str,
    *,
    steps: int,
    karts: Sequence[int],
    track: str | Sequence[str] = "lighthouse",
    cores: int | Sequence[int] | None = None,
) -> argparse.ArgumentParser:
    """Returns a parser with the arguments that all commands share.

    Args:
        doc: module docstring of the command.
        name: name of the default output file in ``benchmarks/results``, without its suffix.
        steps: default of ``--steps``.
        karts: default of ``--karts``.
        track: default of ``--track``; with a sequence, the option accepts several tracks.
        cores: default of ``--cores``; with a sequence, the option accepts several numbers. With
            ``None``, there is no such option and contenders may use all cores.
    """
    made = CommandParser(prog=f"python -m benchmarks.bench_{name}", description=doc)
    made.add_argument(
        "--steps",
        type=_positive,
        default=steps,
        metavar="N",
        help=f"measured steps of each contender (default: {steps})",
    )
    made.add_argument(
        "--karts",
        type=_positive,
        nargs="+",
        default=list(karts),
        metavar="K",
        help=f"numbers of karts (default: {' '.join(map(str, karts))})",
    )
    if isinstance(track, str):
        made.add_argument("--track", default=track, help=f"the track (default: {track})")
    else:
        made.add_argument(
            "--track",
            nargs="+",
            default=list(track),
            choices=SPLITS["all"],
            metavar="NAME",
            help=f"the tracks (default: {len(track)} tracks)",
        )
    if cores is not None:
        made.add_argument(
            "--cores",
            type=_whole,
            nargs=None if isinstance(cores, int) else "+",
            default=cores,
            metavar="N",
            help=f"cores for a contender and its processes, 0 for all (default: {cores})",
        )
    output = RESULTS / f"{name}.json"
    made.add_argument("--output", type=Path, default=output, help="JSON file to write")
    return made


def add_driving(words: argparse.ArgumentParser) -> None:
    """Adds ``--driving`` to a command that compares steps."""
    words.add_argument(
        "--driving",
        choices=("heuristic", "random"),
        default="heuristic",
        help="recorded driving of the heuristic agent, or random actions (default: heuristic)",
    )


def cores(number: int) -> tuple[int, ...]:
    """Returns the last ``number`` cores that this process may use; empty, meaning all, for 0."""
    if not number or not hasattr(os, "sched_getaffinity"):
        return ()
    return tuple(sorted(os.sched_getaffinity(0))[-number:])


def quantiles(values: Iterable[float]) -> dict[str, float]:
    """Returns the median and the 10 and 90% quantiles.

    Raises:
        ValueError: there are no values.
    """
    ordered = sorted(values)
    if not ordered:
        raise ValueError("there are no values, expected at least one measured step")
    cuts = statistics.quantiles(ordered, n=10, method="inclusive") if len(ordered) > 1 else []
    low, high = (cuts[0], cuts[-1]) if cuts else (ordered[0], ordered[0])
    return {"median": statistics.median(ordered), "p10": low, "p90": high}


def figures(times: Times, bare: Times | None = None) -> dict[str, Any]:
    """Returns the figures of a contender.

    Args:
        times: times of the contender.
        bare: times of the bare engine in the same run; ``None`` if it did not run.

    Returns:
        Quantiles of ``step`` and of ``engine``, the time inside ``Race.step`` [µs]; quantiles of
        ``ratio`` (``step / engine``) and ``overhead`` (``step - engine`` [µs]), both computed step
        by step; and ``to_bare``, the median of ``step`` over that of the bare engine.
    """
    pairs = [(t, e) for t, e in zip(times["total"], times["engine"], strict=True) if e]
    found: dict[str, Any] = {"step": quantiles(1e6 * t for t in times["total"])}
    if pairs:
        found["engine"] = quantiles(1e6 * e for _, e in pairs)
        found["ratio"] = quantiles(t / e for t, e in pairs)
        found["overhead"] = quantiles(1e6 * (t - e) for t, e in pairs)
    if bare is not None:
        found["to_bare"] = statistics.median(times["total"]) / statistics.median(bare["engine"])
    return found


def host_facts() -> dict[str, Any]:
    """Returns facts about the machine that matter for the figures, but do not identify it."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "memory_gib": round(_memory_bytes() / 2**30, 1),
        "system": f"{platform.system()} {platform.machine()}",
        "load_at_start": [round(load, 2) for load in _LOAD],
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in _PACKAGES},
    }


def read_rows(file: Path) -> list[dict[str, Any]]:
    """Returns the rows of a file with one JSON object per line; none if there is no file."""
    if not file.exists():
        return []
    return [json.loads(line) for line in file.read_text().splitlines()]


def save(
    output: Path,
    name: str,
    settings: argparse.Namespace,
    results: Sequence[Mapping[str, Any]],
    tables: Sequence[Table],
) -> None:
    """Writes the results as JSON, with the command and the host facts, and prints their tables.

    Args:
        output: file to write.
        name: name of the benchmark: its module without ``bench_``.
        settings: arguments of the command.
        results: the measurements; floats are rounded to five significant digits.
        tables: the results as tables, for the terminal and the documentation.
    """
    # Paths on this machine are irrelevant to the measurement.
    arguments = {k: v for k, v in vars(settings).items() if k not in ("output", "folder")}
    report = {
        "benchmark": name,
        "command": _command(name, arguments),
        "host": host_facts(),
        "settings": arguments,
        "results": results,
        "tables": [asdict(table) for table in tables],
    }
    print_tables(tables)
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(json.dumps(_rounded(report), indent=1) + "\n")
    Console().print(f"written to {output}", markup=False, highlight=False, soft_wrap=True)


@dataclass(frozen=True)
class Table:
    """One table of a report.

    Attributes:
        title: title, with units.
        columns: column headings; the first column is text, the others are figures.
        rows: cells as text.
        note: line below the table.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""


def print_tables(tables: Iterable[Table]) -> None:
    """Prints tables on the terminal."""
    console = Console()
    console.width = max(_TABLE_WIDTH, console.width)
    for table in tables:
        shown = rich.table.Table(
            title=table.title, caption=table.note or None, box=box.SIMPLE, padding=(0, 1, 0, 0)
        )
        for number, column in enumerate(table.columns):
            shown.add_column(column, justify="right" if number else "left", no_wrap=True)
        for row in table.rows:
            shown.add_row(*row)
        console.print(shown)


def spread(found: Mapping[str, float] | None, digits: int = 0) -> str:
    """Formats a median with its quantiles, such as ``"52 (49..60)"``; ``"-"`` for ``None``."""
    if found is None:
        return "-"
    median, low, high = (f"{found[key]:.{digits}f}" for key in ("median", "p10", "p90"))
    return f"{median} ({low}..{high})"


@contextmanager
def progress_bar(total: int) -> Iterator[tuple[Progress, Any]]:
    """Yields a progress bar on stderr, and its task."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as progress:
        yield progress, progress.add_task("", total=total)


_LOAD = os.getloadavg() if hasattr(os, "getloadavg") else ()


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def _whole(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"{text} is less than 0")
    return number


def _command(name: str, arguments: Mapping[str, Any]) -> str:
    words = ["python", "-m", f"benchmarks.bench_{name}"]
    for key, value in arguments.items():
        if value is None or value is False:
            continue
        flag = value is True  # has no value
        parts = value if isinstance(value, (list, tuple)) else [] if flag else [value]
        words += [f"--{key.replace('_', '-')}", *map(str, parts)]
    return " ".join(words)


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _cpu() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def _memory_bytes() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0


def _rounded(value: Any) -> Any:
    """Rounds floats to five significant digits, the precision of the measurements."""
    if isinstance(value, float):
        return float(f"{value:.5g}")
    if isinstance(value, Mapping):
        return {key: _rounded(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(part) for part in value]
    return value
