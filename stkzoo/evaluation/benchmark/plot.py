"""Plots benchmarks: the time ratio on every track, and the win rates."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stkzoo.evaluation.plotting import (
    GREY,
    INK,
    PALETTE,
    draw_intervals,
    new_figure,
    save_figure,
    shorten,
    style_axes,
)

if TYPE_CHECKING:
    from stkzoo.evaluation.benchmark.plan import BenchmarkResult

#: The part of a row's height over which the agents are spread.
_SPREAD = 0.5


def plot_benchmark(
    results: BenchmarkResult | Sequence[BenchmarkResult], path: str | os.PathLike[str]
) -> None:
    """Plots one or more results into a file, atomically.

    Args:
        results: of one agent or of several.
        path: the file; its ending selects the format, such as ``.png`` or ``.svg``.

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
    figure = new_figure(10, 1.9 + len(rows) * (0.2 + 0.12 * len(drawn)))
    times, wins = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw(times, drawn, rows, "time_ratio")
    times.axvline(1.0, color=GREY, linewidth=1, linestyle="--", zorder=0)
    style_axes(times, "Time as a multiple of the AI's; less is better")
    _draw(wins, drawn, contests, "win_rate", scale=100)
    for row, (_, name) in enumerate(contests):
        chance = 100 * (chances[name] or 0.0)
        wins.plot([chance, chance], [row - 0.35, row + 0.35], color=GREY, linewidth=2, zorder=0)
    wins.set_xlim(-3, 103)
    style_axes(wins, "Races won [%]; the mark is chance")
    figure.suptitle(_title(drawn), color=INK, fontsize=11)
    if len(drawn) > 1:
        figure.legend(*times.get_legend_handles_labels(), loc="outside lower center", ncols=6)
    save_figure(figure, path)


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
        estimates = {row: known.get(key) for row, key in enumerate(rows)}
        points = {row: estimate for row, estimate in estimates.items() if estimate is not None}
        draw_intervals(
            axes,
            [row + shift for row in points],
            [scale * estimate.value for estimate in points.values()],
            [(scale * low, scale * high) for low, high in (e.interval for e in points.values())],
            color=PALETTE[number % len(PALETTE)],
            label=shorten(result.label),
        )
    axes.set_yticks(range(len(rows)), [name or "all races" for _, name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)


def _title(results: Sequence[BenchmarkResult]) -> str:
    plan = results[0].plan
    who = results[0].label if len(results) == 1 else f"{len(results)} agents"
    races = max(len(result.outcomes) for result in results)
    return f"{who}: {races} races on {plan.split}, AI difficulty {plan.settings.difficulty}"
