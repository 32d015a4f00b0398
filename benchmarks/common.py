"""Shared parts of the benchmark programs: options, figures, tables, and saved results."""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import os
import platform
import statistics
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import rich.table
from rich import box
from rich.console import Console

from stkzoo._os import write_text

RESULTS = Path(__file__).parent / "results"
#: Minimum width of tables, even if the terminal is narrower.
_TABLE_WIDTH = 200
_PACKAGES = ("stkzoo", "PySuperTuxKart2", "pystk2-gymnasium", "numpy", "numba", "gymnasium")
_LOAD = os.getloadavg() if hasattr(os, "getloadavg") else ()

#: Duration of each measured step of a contender [s]: ``total`` for the caller, ``engine`` inside
#: ``pystk2.Race.step`` (``None`` if not measured).
Times = dict[str, list[Any]]


def parser(program: str, doc: str | None) -> argparse.ArgumentParser:
    """Returns the parser of a program."""
    words = argparse.ArgumentParser(
        prog=f"python -m benchmarks.{program}",
        description=doc,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    words.set_defaults(program=program)
    return words


def positive(text: str) -> int:
    """Returns the number of an option that is at least 1."""
    if (number := int(text)) < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def cores(number: int) -> tuple[int, ...]:
    """Returns the last ``number`` cores that this process may use; empty, meaning all, for 0."""
    if not number or not hasattr(os, "sched_getaffinity"):
        return ()
    return tuple(sorted(os.sched_getaffinity(0))[-number:])


# ---------------------------------------------------------------------- figures


def quantiles(values: Iterable[float]) -> dict[str, float]:
    """Returns the median and the 10 and 90% quantiles of at least one value."""
    ordered = sorted(values)
    cuts = statistics.quantiles(ordered, n=10, method="inclusive") if len(ordered) > 1 else ordered
    return {"median": statistics.median(ordered), "p10": cuts[0], "p90": cuts[-1]}


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
    result: dict[str, Any] = {"step": quantiles(1e6 * t for t in times["total"])}
    if pairs:
        result["engine"] = quantiles(1e6 * e for _, e in pairs)
        result["ratio"] = quantiles(t / e for t, e in pairs)
        result["overhead"] = quantiles(1e6 * (t - e) for t, e in pairs)
    if bare is not None:
        result["to_bare"] = statistics.median(times["total"]) / statistics.median(bare["engine"])
    return result


def spread(values: Mapping[str, float] | None, digits: int = 0) -> str:
    """Formats a median with its quantiles, such as ``"52 (49..60)"``; ``"-"`` for ``None``."""
    if values is None:
        return "-"
    median, low, high = (f"{values[key]:.{digits}f}" for key in ("median", "p10", "p90"))
    return f"{median} ({low}..{high})"


# ---------------------------------------------------------------------- tables


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


# ---------------------------------------------------------------------- results

Result = dict[str, Any]


def measure_all(
    output: Path,
    options: argparse.Namespace,
    jobs: Sequence[Mapping[str, Any]],
    measure: Callable[[Mapping[str, Any]], Mapping[str, Any]],
    tables: Callable[[list[Result]], Iterable[Table]],
) -> list[Result]:
    """Measures all jobs, prints their tables, and saves them.

    The results are saved after each job. If the file has some of the jobs with the same options,
    the others are measured; if it has all of them, they are measured again.

    Args:
        output: JSON file with the results, the command, the host facts and the tables.
        options: the options of the command, with the ``program`` of :func:`parser`.
        jobs: what to measure; each job is a part of its result.
        measure: returns the rest of a job's result.
        tables: returns the tables of the results.

    Returns:
        The results.
    """
    # Paths on this machine are irrelevant to the measurement.
    named = vars(options).items()
    settings = {name: value for name, value in named if not isinstance(value, Path)}
    results = _interrupted(output, settings, len(jobs))
    output.parent.mkdir(parents=True, exist_ok=True)
    with Console(stderr=True).status("") as status:
        for job in jobs[len(results) :]:
            words = ", ".join(f"{name}: {value}" for name, value in job.items())
            status.update(f"{len(results)} of {len(jobs)} done; {words}")
            results.append(_rounded({**job, **measure(job)}))
            report = {
                "command": _command(settings),
                "host": host_facts(),
                "settings": settings,
                "results": results,
                "tables": [asdict(table) for table in tables(results)],
            }
            write_text(output, json.dumps(report, indent=1) + "\n")
    print_tables(tables(results))
    print(f"written to {output.name}")
    return results


def _interrupted(output: Path, settings: Mapping[str, Any], number: int) -> list[Result]:
    """Returns the results of an interrupted run with the same options."""
    if not output.exists():
        return []
    report = json.loads(output.read_text())
    is_same = report.get("settings") == json.loads(json.dumps(settings))
    results: list[Result] = report["results"]
    return results if is_same and len(results) < number else []


def _command(settings: Mapping[str, Any]) -> str:
    """Returns the command with all of its options."""
    words = ["python", "-m", f"benchmarks.{settings['program']}"]
    for name, value in settings.items():
        if name == "program" or value is None or value is False:
            continue
        values = value if isinstance(value, (list, tuple)) else [] if value is True else [value]
        words += [f"--{name.replace('_', '-')}", *map(str, values)]
    return " ".join(words)


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
