"""Benchmarks as a picture: the time ratio on every track, and the races won."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

from stkzoo.evaluation.batch.figure import BLUE, GREY, INK, plot_library, save_figure, short
from stkzoo.evaluation.benchmark.figures import Estimate
from stkzoo.evaluation.benchmark.result import BenchmarkResult

__all__ = ["check_plot_library", "save_plot"]

_EXTRA = "benchmark"
_COLOURS = (BLUE, "#d1762b", "#3b8f5a", "#8a5bb0", "#b23b4e", "#5b6f7d")
_SPREAD = 0.5  # of the room that a row has


def check_plot_library() -> None:
    """Checks that the library which draws is there.

    Raises:
        ConfigError: it is not installed.
    """
    plot_library(_EXTRA)


def save_plot(
    results: BenchmarkResult | Sequence[BenchmarkResult], path: str | os.PathLike[str]
) -> None:
    """Draws one or more results into a file, whole or not at all.

    Args:
        results: of one agent or of several.
        path: the file; its ending says the format, such as ``.png`` or ``.svg``.

    Raises:
        ConfigError: the library is not installed, or the file cannot be written.
    """
    drawn = [results] if isinstance(results, BenchmarkResult) else list(results)
    rows = list(dict.fromkeys(_row for result in drawn for _row in _rows(result)))
    forms = list(dict.fromkeys(g.name for r in drawn for g in r.groups if g.by == "form"))
    against = [name for name in forms if "A" in name]
    height = 1.9 + len(rows) * (0.2 + 0.12 * len(drawn))
    figure = plot_library(_EXTRA).Figure(figsize=(10, height), layout="constrained")
    times, wins = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw(times, drawn, rows, "time_ratio")
    times.axvline(1.0, color=GREY, linewidth=1, linestyle="--", zorder=0)
    times.set_title("Time as a multiple of the AI's; less is better", fontsize=10, color=INK)
    _draw(wins, drawn, [("form", name) for name in against], "win_rate", percent=True)
    _draw_chances(wins, drawn, against)
    wins.set_title("Races won [%]; the mark is chance", fontsize=10, color=INK)
    wins.set_xlim(-3, 103)
    figure.suptitle(_title(drawn), color=INK, fontsize=11)
    if len(drawn) > 1:
        figure.legend(*times.get_legend_handles_labels(), loc="outside lower center", ncols=6)
    save_figure(figure, path)


def _rows(result: BenchmarkResult) -> list[tuple[str, str]]:
    found = [(group.by, group.name) for group in result.groups]
    return [
        *(row for row in found if row[0] == "all"),
        *(row for row in found if row[0] == "direction"),
        *(row for row in found if row[0] == "track"),
    ]


def _draw(
    axes: Any,
    results: Sequence[BenchmarkResult],
    rows: Sequence[tuple[str, str]],
    figure: str,
    *,
    percent: bool = False,
) -> None:
    scale = 100 if percent else 1
    for number, result in enumerate(results):
        shift = _SPREAD * ((number + 0.5) / len(results) - 0.5)
        known = {(group.by, group.name): group.figures[figure] for group in result.groups}
        points = [(row, known[key]) for row, key in enumerate(rows) if known.get(key) is not None]
        values = [scale * estimate.value for _, estimate in points if estimate]
        axes.errorbar(
            values,
            [row + shift for row, _ in points],
            xerr=_errors([estimate for _, estimate in points if estimate], scale),
            fmt="o",
            color=_COLOURS[number % len(_COLOURS)],
            elinewidth=1.6,
            capsize=3,
            markersize=5,
            label=short(result.label),
        )
    axes.set_yticks(range(len(rows)), [name or "all races" for _, name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="x", alpha=0.3)
    axes.tick_params(length=0, colors=INK, labelsize=9)
    for side in ("top", "right", "left", "bottom"):
        axes.spines[side].set_visible(False)


def _errors(estimates: Sequence[Estimate], scale: float) -> list[list[float]]:
    sure = [
        (e.value if e.low is None else e.low, e.value if e.high is None else e.high)
        for e in estimates
    ]
    return [
        [scale * max(e.value - low, 0.0) for e, (low, _) in zip(estimates, sure, strict=True)],
        [scale * max(high - e.value, 0.0) for e, (_, high) in zip(estimates, sure, strict=True)],
    ]


def _draw_chances(axes: Any, results: Sequence[BenchmarkResult], forms: Sequence[str]) -> None:
    chances = {g.name: g.chance for result in results for g in result.groups if g.by == "form"}
    for row, name in enumerate(forms):
        chance = 100 * (chances[name] or 0.0)
        axes.plot([chance, chance], [row - 0.35, row + 0.35], color=GREY, linewidth=2, zorder=0)


def _title(results: Sequence[BenchmarkResult]) -> str:
    plan = results[0].plan
    who = results[0].label if len(results) == 1 else f"{len(results)} agents"
    races = max(len(result.outcomes) for result in results)
    return f"{who}: {races} races on {plan.split}, AI difficulty {plan.settings.difficulty}"
