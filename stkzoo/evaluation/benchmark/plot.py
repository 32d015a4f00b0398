"""The plot of benchmarks: the time ratio on every track, and the win rates."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from stkzoo.evaluation.benchmark.plan import BenchmarkResult
from stkzoo.evaluation.plotting import (
    GRAY,
    PALETTE,
    draw_intervals,
    shorten,
    style_axes,
    two_panels,
)

#: Fraction of a row's height over which the agents are spread.
_SPREAD = 0.5


def plot_benchmark(
    results: BenchmarkResult | Sequence[BenchmarkResult], path: str | os.PathLike[str]
) -> None:
    """Plots one or more results to a file, which is written atomically.

    Args:
        results: result of one agent, or results of several agents.
        path: the file; its suffix selects the format, such as ``.png`` or ``.svg``.

    Raises:
        ConfigError: matplotlib is not installed, or the file cannot be written.
    """
    drawn = list(results) if isinstance(results, Sequence) else [results]
    groups = [group for result in drawn for group in result.groups]
    rows = [
        (by, name)
        for by in ("all", "direction", "track")
        for name in dict.fromkeys(group.name for group in groups if group.by == by)
    ]
    chances = {group.name: group.chance for group in groups if group.by == "form"}
    contests = [("form", name) for name, chance in chances.items() if chance is not None]
    height = 1.9 + len(rows) * (0.2 + 0.12 * len(drawn))
    with two_panels(path, _title(drawn), 10, height, (3, 2)) as (times, wins):
        _draw(times, drawn, rows, "time_ratio")
        times.axvline(1.0, color=GRAY, linewidth=1, linestyle="--", zorder=0)
        style_axes(times, "Time as a multiple of the AI's; less is better")
        _draw(wins, drawn, contests, "win_rate", scale=100)
        for row, (_, name) in enumerate(contests):
            chance, ends = 100 * (chances[name] or 0.0), [row - 0.35, row + 0.35]
            wins.plot([chance, chance], ends, color=GRAY, linewidth=2, zorder=0)
        wins.set_xlim(-3, 103)
        style_axes(wins, "Races won [%]; the mark is chance")
        if len(drawn) > 1:
            handles = times.get_legend_handles_labels()
            times.figure.legend(*handles, loc="outside lower center", ncols=6)


def _draw(
    axes: Any,
    results: Sequence[BenchmarkResult],
    rows: Sequence[tuple[str, str]],
    figure: str,
    scale: float = 1,
) -> None:
    for number, result in enumerate(results):
        shift = _SPREAD * ((number + 0.5) / len(results) - 0.5)
        known = {(group.by, group.name): group.figures[figure] for group in result.groups}
        estimates = {row + shift: known.get(key) for row, key in enumerate(rows)}
        draw_intervals(
            axes,
            {row: estimate for row, estimate in estimates.items() if estimate is not None},
            scale=scale,
            color=PALETTE[number % len(PALETTE)],
            label=shorten(result.label),
        )
    axes.set_yticks(range(len(rows)), [name or "all races" for _, name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)


def _title(results: Sequence[BenchmarkResult]) -> str:
    plan = results[0].plan
    who = results[0].label if len(results) == 1 else f"{len(results)} agents"
    races = max(len(result.races) for result in results)
    return f"{who}: {races} races on {plan.split}, AI difficulty {plan.settings.difficulty}"
