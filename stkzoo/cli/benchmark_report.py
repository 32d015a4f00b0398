"""What ``stkzoo benchmark`` shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from stkzoo.evaluation import BenchmarkResult, Comparison, Estimate

__all__ = ["show_comparison", "show_results"]

_MAIN = ("all", "form")
_SHOWN = (*_MAIN, "direction", "end", "track")
#: What a line needs; on a narrower terminal the intervals stand below.
_WIDTH = 145
#: Title of each figure, what it is multiplied with, and its decimals.
_COLUMNS = {
    "time_ratio": ("time ratio", 1, 3),
    "win_rate": ("won %", 100, 1),
    "mean_rank": ("rank", 1, 2),
    "unfinished": ("DNF %", 100, 1),
    "rescues": ("rescues", 1, 2),
}


def show_results(results: Sequence[BenchmarkResult]) -> None:
    """Prints what one agent came to, or the main lines of several."""
    console, is_wide = _console()
    is_one = len(results) == 1
    names = ("races on", "n", "chance", *_titles())
    table = _table(console, names if is_one else ("agent", *names))
    for result in results:
        first = escape(result.label)
        for group in result.groups:
            if group.by in (_SHOWN if is_one else _MAIN):
                chance = "-" if group.chance is None else f"{100 * group.chance:.0f} %"
                figures = _cells(group.figures, is_wide)
                cells = (group.name or "all", str(group.races), chance, *figures)
                style = "bold" if group.by == "all" else None
                table.add_row(*cells if is_one else (first, *cells), style=style)
                first = ""
    console.print(table)
    for result in results:
        console.print(_told(result), highlight=False, markup=False, soft_wrap=True)


def _told(result: BenchmarkResult) -> str:
    plan = result.plan
    errors = f"; the agent failed {result.errors} times" if result.errors else ""
    return (
        f"{result.label}: {len(result.outcomes)} of {len(plan.races())} races on "
        f"{', '.join(plan.tracks)}; AI difficulty {plan.settings.difficulty}; with 95 % "
        f"intervals{errors}."
    )


def show_comparison(comparison: Comparison) -> None:
    """Prints by how much two agents differ."""
    console, is_wide = _console()
    console.print(
        f"\n{comparison.first} minus {comparison.second}, in the same races:",
        highlight=False,
        markup=False,
    )
    table = _table(console, ("races on", "n", *_titles()))
    for difference in comparison.differences:
        if difference.by in _SHOWN:
            table.add_row(
                difference.name or "all",
                str(difference.races),
                *_cells(difference.figures, is_wide, sign="+"),
                style="bold" if difference.by == "all" else None,
            )
    console.print(table)


def _table(console: Console, columns: Sequence[str]) -> Table:
    has_frame = console.is_terminal and console.width >= _WIDTH
    table = Table(box=box.ROUNDED if has_frame else None, pad_edge=has_frame)
    for name in columns:
        is_text = name in ("agent", "races on")
        table.add_column(name, justify="left" if is_text else "right", overflow="fold")
    return table


def _titles() -> list[str]:
    return [title for title, _, _ in _COLUMNS.values()]


def _cells(figures: Mapping[str, Estimate | None], is_wide: bool, sign: str = "") -> list[str]:
    return [
        _in_words(figures[name], scale, f"{sign}.{decimals}f", is_wide)
        for name, (_, scale, decimals) in _COLUMNS.items()
    ]


def _in_words(estimate: Estimate | None, scale: float, form: str, is_wide: bool) -> str:
    if estimate is None:
        return "-"
    value = format(scale * estimate.value, form)
    if estimate.low is None or estimate.high is None:
        return value
    low, high = (format(scale * end, form) for end in (estimate.low, estimate.high))
    return f"{value} ({low}..{high})" if is_wide else f"{value}\n{low}..{high}"


def _console() -> tuple[Console, bool]:
    """The terminal, or a page that is wide enough; and whether it is."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=max(console.width, _WIDTH))
    return console, console.width >= _WIDTH
