"""Builds the page of benchmark results from the tables in ``benchmarks/results``."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
#: Title of the section of each result file.
_SECTIONS = {
    "steps": "Steps",
    "transport": "The worker's transport",
    "profile": "The parts of a step",
    "vector": "Many races",
    "learners": "Learners",
    "learners_scale": "Learners by karts, races and cores",
    "learners_16_cores": "Learners on 16 cores",
    "nodes": "Learners on several nodes",
    "states": "Saved states",
    "resets": "Imports and resets",
    "memory": "Memory",
    "scaling": "More karts, other tracks",
    "engine": "Thinned scenes",
    "remote": "Networked races",
}
_HEAD = """# Benchmark results

[Benchmarks](../explanation/benchmarks.md) has the charts and the method. *Reference* means
pystk2-gymnasium 0.10.0. Figures are medians, with the 10 and 90% quantiles in brackets. Commands
named `bench_...` are of an
[earlier version](../explanation/benchmarks.md#measurements-that-ended).
"""


def pages() -> dict[str, str]:
    """Returns the text of the page."""
    sections = (_section(name, title) for name, title in _SECTIONS.items())
    lines = [line for section in sections for line in section]
    return {"reference/benchmark-results.md": "\n".join([_HEAD, *lines])}


def _section(name: str, title: str) -> Iterator[str]:
    report = json.loads((RESULTS / f"{name}.json").read_text("utf-8"))
    yield f"## {title}\n"
    yield f"```\n{report['command']}\n```\n"
    yield _host(report["host"])
    for table in report["tables"]:
        yield f"**{table['title']}**\n"
        yield from _rows(table)
        yield f"\n{table['note']}\n"


def _rows(table: Mapping[str, Any]) -> Iterator[str]:
    rule = [":--", *["--:"] * (len(table["columns"]) - 1)]
    for cells in (table["columns"], rule, *table["rows"]):
        yield f"| {' | '.join(cells)} |"


def _host(host: Mapping[str, Any]) -> str:
    packages = ", ".join(f"{name} {version}" for name, version in host["packages"].items())
    return (
        f"{host['cpu']}, {host['cores']} cores, {host['memory_gib']} GiB, {host['system']}; "
        f"Python {host['python']}; {packages}; load before the start "
        f"{' '.join(map(str, host['load_at_start']))}.\n"
    )
