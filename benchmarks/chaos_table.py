"""Builds the table of ``docs/explanation/robustness.md`` from the saved results.

python -m benchmarks.chaos_table            # print it
python -m benchmarks.chaos_table --write    # write it to the page
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from stkzoo._arguments import CommandParser
from stkzoo._os import write_text

RESULTS = Path(__file__).parent / "results" / "robustness"
PAGE = Path(__file__).parents[1] / "docs" / "explanation" / "robustness.md"
_BEGIN, _END = "<!-- table: begin -->", "<!-- table: end -->"
_HEAD = "| what | tried | survived | lost | command |\n| --- | ---: | ---: | ---: | --- |"


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the table or writes it to the page."""
    words = CommandParser(prog="python -m benchmarks.chaos_table", description=__doc__)
    words.add_argument("--write", action="store_true", help="write it to the page")
    if words.parse_args(argv).write:
        write_text(PAGE, updated(PAGE.read_text(encoding="utf-8")))
    else:
        print(table())
    return 0


def updated(page: str) -> str:
    """Returns the page with the current table."""
    before, _, rest = page.partition(_BEGIN)
    return f"{before}{_BEGIN}\n{table()}\n{_END}{rest.partition(_END)[2]}"


def table() -> str:
    """Returns the table as Markdown."""
    rows = [*_faults(), *_fuzz(), *_soak(), *_training()]
    return "\n".join([_HEAD, *(f"| {' | '.join(row)} |" for row in rows)])


def _row(what: str, tried: int, lost: int, command: str) -> tuple[str, ...]:
    return what, f"{tried:,}", f"{tried - lost:,}", f"{lost:,}", f"`python -m {command}`"


def _faults() -> Iterator[tuple[str, ...]]:
    rows = _lines("faults.jsonl")
    for form in [*sorted({row["form"] for row in rows}), ""]:
        hits = [row for row in rows if row["injected"] and form in ("", row["form"])]
        lost = sum(not row["survived"] for row in rows if form in ("", row["form"]))
        what = f"faults: {form}" if form else "**faults, all**"
        yield _row(what, len(hits), lost, "benchmarks.chaos")


def _fuzz() -> Iterator[tuple[str, ...]]:
    readers = _form("fuzz.json").get("readers", {})
    for name, row in readers.items():
        command = f"benchmarks.fuzz --readers {json.dumps(name) if ' ' in name else name}"
        yield _row(f"inputs: {name}", row["inputs"], len(row["findings"]), command)
    tried = sum(row["inputs"] for row in readers.values())
    lost = sum(len(row["findings"]) for row in readers.values())
    yield _row("**inputs, all**", tried, lost, "benchmarks.fuzz")


def _soak() -> Iterator[tuple[str, ...]]:
    rows = _lines("soak.jsonl")
    lost = sum(bool(row["events"] or row["problem"]) for row in rows)
    yield _row("**races** of random actions and bots", len(rows), lost, "benchmarks.soak")
    again = [row for row in rows if row["again"]]
    differing = sum("driven again" in row["problem"] for row in again)
    yield _row("races driven again, bit for bit", len(again), differing, "benchmarks.soak")


def _training() -> Iterator[tuple[str, ...]]:
    found = _form("training.json")
    if found:
        lost = 0 if found["survived"] else found["kills"]
        what = f"kills in one training of {found['steps']:,} steps"
        yield _row(what, found["kills"], lost, "benchmarks.chaos_training")


def _lines(name: str) -> list[dict[str, Any]]:
    file = RESULTS / name
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def _form(name: str) -> dict[str, Any]:
    file = RESULTS / name
    found: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    return found


if __name__ == "__main__":
    sys.exit(main())
