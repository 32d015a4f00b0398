"""``stkzoo doctor``: what works on this machine."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stkzoo.cli.diagnosis import Finding

__all__ = ["add_parser"]

_ABOUT = """\
Looks at everything that stkzoo needs or can use, and names the command that mends
what is missing. Succeeds if a headless race can run here.
"""

_EXAMPLES = """\
examples:
  stkzoo doctor           a table
  stkzoo doctor --json    the same for programs
"""


def add_parser(subparsers: argparse._SubParsersAction[Any]) -> None:
    """Adds the command."""
    parser = subparsers.add_parser(
        "doctor",
        help="what works on this machine, and what mends the rest",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="write JSON instead of a table")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    from stkzoo.cli.diagnosis import diagnose

    findings = diagnose()
    ready = all(finding.ok for finding in findings if finding.required)
    if arguments.json:
        _write_json(findings, ready)
    else:
        _write_table(findings, ready)
    return 0 if ready else 1


def _write_json(findings: list[Finding], ready: bool) -> None:
    import json
    from dataclasses import asdict

    report = {"ready": ready, "checks": [asdict(finding) for finding in findings]}
    print(json.dumps(report, indent=2))


def _write_table(findings: list[Finding], ready: bool) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    console = Console()
    table = Table("", "check")
    table.add_column("found", overflow="fold")
    table.add_column("remedy", overflow="fold")
    for finding in findings:
        verdict = "ok" if finding.ok else "missing" if finding.required else "without"
        colour = "green" if finding.ok else "red" if finding.required else "yellow"
        remedy = "" if finding.ok else finding.remedy
        texts = (Text(text) for text in (finding.name, finding.found, remedy))
        table.add_row(Text(verdict, colour), *texts)
    console.print(table)
    last = "A headless race can run here." if ready else "No race can run here yet: see above."
    console.print(last)
