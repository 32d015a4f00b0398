"""Writes ``docs/reference/benchmark-results.md`` from the saved results.

python -m benchmarks.bench_tables
python -m benchmarks.bench_tables --results trial --output page.md
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import (
    bench_engine,
    bench_learners,
    bench_memory,
    bench_nodes,
    bench_profile,
    bench_remote,
    bench_resets,
    bench_scaling,
    bench_states,
    bench_steps,
    bench_transport,
    bench_vector,
)
from benchmarks.bench_common import RESULTS, Table
from stkzoo._arguments import CommandParser

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "benchmark-results.md"

_SECTIONS: dict[str, tuple[str, Callable[[Any], Sequence[Table]]]] = {
    "steps": ("Steps", bench_steps.tables),
    "transport": ("The worker's transport", bench_transport.tables),
    "profile": ("The parts of a step", bench_profile.tables),
    "vector": ("Many races", bench_vector.tables),
    "learners": ("Learners", bench_learners.tables),
    "learners_scale": ("Learners by karts, races and cores", bench_learners.tables),
    "learners_16_cores": ("Learners on 16 cores", bench_learners.tables),
    "nodes": ("Learners on several nodes", bench_nodes.tables),
    "states": ("Saved states", bench_states.tables),
    "resets": ("Imports and resets", bench_resets.tables),
    "memory": ("Memory", bench_memory.tables),
    "scaling": ("More karts, other tracks", bench_scaling.tables),
    "engine": ("Thinned scenes", bench_engine.tables),
    "remote": ("Networked races", bench_remote.tables),
}

_HEAD = """# Benchmark results

`python -m benchmarks.bench_tables` writes this page from `benchmarks/results`; `make bench`
measures everything again first. [Benchmarks](../explanation/benchmarks.md) has the charts and the
method. *Reference* means pystk2-gymnasium 0.10.0. Figures are medians, with the 10 and 90%
quantiles in brackets.
"""


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    words = CommandParser(prog="python -m benchmarks.bench_tables", description=__doc__)
    words.add_argument("--results", type=Path, default=RESULTS, help="folder of the JSON files")
    words.add_argument("--output", type=Path, default=PAGE, help="page to write")
    options = words.parse_args(arguments)
    reports = {
        name: json.loads(path.read_text())
        for name in _SECTIONS
        if (path := options.results / f"{name}.json").exists()
    }
    if not reports:
        words.error(f"there are no results in {options.results}; run make bench")
    options.output.write_text(page(reports))
    print(f"written to {options.output}")
    return 0


def page(reports: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns the whole page.

    Args:
        reports: saved results of the benchmarks, by name.
    """
    parts = [_HEAD]
    for name, report in reports.items():
        title, tables = _SECTIONS[name]
        parts += [f"## {title}\n", f"```\n{report['command']}\n```\n", _host(report["host"])]
        parts += [table.to_markdown() for table in tables(report["results"])]
    return "\n".join(parts)


def _host(host: Mapping[str, Any]) -> str:
    load = host["load_at_start"]
    packages = ", ".join(f"{name} {version}" for name, version in host["packages"].items())
    return (
        f"{host['cpu']}, {host['cores']} cores, {host['memory_gib']} GiB, {host['system']}; "
        f"Python {host['python']}; {packages}; load before the start "
        f"{' '.join(map(str, load))}.\n"
    )


if __name__ == "__main__":
    sys.exit(main())
