"""Draws the charts of ``docs/explanation`` from the saved results.

python docs/_extensions/charts.py
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from stkzoo.evaluation.plotting import (
    GRAY,
    INK,
    PALETTE,
    new_figure,
    save_figure,
    style_axes,
)

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
PICTURES = Path(__file__).parents[1] / "images" / "benchmarks"
WIDTH = 8.0  # [in]
_DRIVERS = ("random", "ai", "scout", "heuristic", "ace", "apex", "zenith")
_FORMS = {"P": "alone", "PAAAA": "one against four", "PPAAA": "two against three"}


def throughput(results: Path, axes: Any) -> None:
    """Draws the steps per second of races whose karts are all agents, also in the reference."""
    contenders = {"engine": GRAY, "stkzoo, worker": PALETTE[0], "reference, in process": PALETTE[1]}
    titles = ("the engine alone", "stkzoo", "pystk2-gymnasium")
    rows = [row for row in _load(results / "steps.json") if row["group"] == "multi"]
    width = 0.8 / len(contenders)
    for number, ((name, color), title) in enumerate(zip(contenders.items(), titles, strict=True)):
        rates = [1e6 / row["contenders"][name]["step"]["median"] for row in rows]
        places = [place + (number - 1) * width for place in range(len(rows))]
        bars = axes.bar(places, rates, width * 0.92, color=color, label=title)
        axes.bar_label(bars, [f"{rate:,.0f}" for rate in rates], fontsize=8)
    axes.set_xticks(range(len(rows)), [f"{row['karts']} karts" for row in rows])
    axes.set_yscale("log")
    axes.set_yticks([])
    axes.minorticks_off()
    axes.legend(frameon=False, fontsize=9)
    style_axes(axes, "Environment steps per second, all karts agents; log scale, more is better")


def scaling(results: Path, axes: Any) -> None:
    """Draws the time of a step against the number of karts."""
    lines = {"engine": GRAY, "flattened, worker": PALETTE[0], "full, worker": PALETTE[2]}
    titles = ("the engine alone", "stkzoo, flattened view", "stkzoo, full view")
    rows = [row for row in _load(results / "scaling.json") if row["part"] == "karts"]
    karts = [row["karts"] for row in rows]
    for (name, color), title in zip(lines.items(), titles, strict=True):
        steps = [row["contenders"][name]["step"]["median"] / 1000 for row in rows]
        axes.plot(karts, steps, "o-", markersize=4, color=color, label=title)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(karts, map(str, karts))
    axes.set_yticks([0.2, 1, 5, 20], ["0.2", "1", "5", "20"])
    axes.minorticks_off()
    axes.grid(color=GRAY, alpha=0.25)
    axes.set_xlabel("karts", fontsize=9)
    axes.legend(frameon=False, fontsize=9)
    style_axes(axes, "One step of all karts [ms]; log scales, less is better")


def drivers(results: Path, axes: Any) -> None:
    """Draws the fraction of races won against four of the hardest AI karts, with 95% intervals."""
    for row, name in enumerate(_DRIVERS):
        figures = _figures(results, name, "PAAAA")
        won = {key: 100 * figures["win_rate"][key] for key in ("value", "low", "high")}
        axes.plot([won["low"], won["high"]], [row, row], color=PALETTE[0], linewidth=3, alpha=0.5)
        axes.plot(won["value"], row, "o", color=PALETTE[0])
        axes.text(won["high"] + 1, row, f"{won['value']:.0f}%", va="center", fontsize=9)
    axes.axvline(20, color=GRAY, linewidth=1, linestyle="--", zorder=0)
    axes.set_yticks(range(len(_DRIVERS)), _DRIVERS)
    axes.set_xlim(-1, 75)
    style_axes(axes, "Races won against four of the hardest AI karts [%]; the line is chance")


def time_ratios(results: Path, axes: Any) -> None:
    """Draws the time ratios on the test tracks by race form, with 95% intervals."""
    names = _DRIVERS[1:]  # random never finishes
    for number, (form, title) in enumerate(_FORMS.items()):
        color = PALETTE[number]
        for row, name in enumerate(names):
            ratio = _figures(results, name, form)["time_ratio"]
            place = row + 0.22 * (1 - number)
            interval = [ratio["low"], ratio["high"]]
            axes.plot(interval, [place, place], color=color, linewidth=3, alpha=0.5)
            axes.plot(ratio["value"], place, "o", color=color, label=None if row else title)
    axes.axvline(1, color=GRAY, linewidth=1, linestyle="--", zorder=0)
    axes.set_yticks(range(len(names)), names)
    axes.legend(frameon=False, fontsize=9, loc="lower left")
    style_axes(axes, "Finish time on the test tracks over the AI's median time; less is better")


def ratings(results: Path, axes: Any) -> None:
    """Draws the ratings of a run's policies over kart-steps, with 95% intervals."""
    found = json.loads((results / "learning" / "apex" / "ratings.json").read_text())
    rows = {row["name"]: row for row in found["ratings"]}
    ai, start = rows.pop("ai"), rows.pop("start")
    kept = sorted((float(name.split()[-1]), row) for name, row in rows.items())
    steps, own = [0.0, *(at for at, _ in kept)], [start, *(row for _, row in kept)]
    low, value, high = ([row[key] for row in own] for key in ("low", "value", "high"))
    axes.fill_between(steps, low, high, color=PALETTE[0], alpha=0.2, linewidth=0)
    axes.plot(steps, value, "o-", color=PALETTE[0])
    axes.axhspan(ai["low"], ai["high"], color=GRAY, alpha=0.15, linewidth=0)
    axes.axhline(ai["value"], color=GRAY, linewidth=1, linestyle="--")
    axes.text(steps[-1], ai["value"], "the hardest AI", va="bottom", ha="right", fontsize=9)
    axes.set_xlabel("millions of kart-steps; 0 is the plans", fontsize=9)
    style_axes(axes, "Rating of the policy of apex while it learns; more is better")


def crossplay(results: Path, axes: Any) -> None:
    """Draws how often each driver of the suite's population beats each of the others."""
    cells = json.loads((results / "suite_crossplay.json").read_text())["cells"]
    shares = {(cell["row"], cell["column"]): cell["value"] for cell in cells}
    names = [*dict.fromkeys(cell["row"] for cell in cells)]
    mean = {one: fmean(shares[one, two] for two in names if (one, two) in shares) for one in names}
    names.sort(key=lambda name: -mean[name])
    rows = [[shares.get((one, two)) for two in names] for one in names]
    _draw_shares(axes, rows, [name.removeprefix("pretrained:") for name in names])
    style_axes(axes, "Races in which the row beats the column [%]; best driver first")


def _draw_shares(
    axes: Any, shares: Sequence[Sequence[float | None]], labels: Sequence[str]
) -> None:
    """Draws a square matrix of shares in percent, with colors from red (0) to blue (1).

    Args:
        axes: the ``matplotlib`` axes.
        shares: share of each row and column, 0 to 1; ``None`` if unknown.
        labels: labels of the rows and columns.
    """
    numbers = np.array([[np.nan if s is None else s for s in row] for row in shares], float)
    axes.imshow(numbers, cmap="RdBu", vmin=-0.25, vmax=1.25, aspect="auto")
    for one, row in enumerate(shares):
        for two, share in enumerate(row):
            text = "" if one == two else "-" if share is None else f"{100 * share:.0f}"
            is_dark = share is not None and abs(share - 0.5) > 0.4
            color = "white" if is_dark else INK
            axes.text(two, one, text, ha="center", va="center", fontsize=8, color=color)
    axes.set_xticks(range(len(labels)), labels, rotation=35, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(labels)), labels)


#: Drawing function and height [in] of each chart, by name.
CHARTS: dict[str, tuple[Callable[[Path, Any], None], float]] = {
    "throughput": (throughput, 3.0),
    "scaling": (scaling, 3.0),
    "drivers": (drivers, 3.0),
    "time_ratios": (time_ratios, 3.0),
    "ratings": (ratings, 3.0),
    "crossplay": (crossplay, 5.0),
}


def main(output: Path = PICTURES) -> None:
    """Draws all charts into a folder."""
    output.mkdir(parents=True, exist_ok=True)
    for name, (draw, height) in CHARTS.items():
        figure = new_figure(WIDTH, height)
        draw(RESULTS, figure.add_subplot())
        save_figure(figure, output / f"{name}.svg")


def _figures(results: Path, driver: str, form: str) -> Mapping[str, Any]:
    """Returns the figures of a driver's races of one form on the test tracks."""
    found = json.loads((results / "benchmark" / f"{driver}.json").read_text())
    own = (group for group in found["groups"] if (group["by"], group["name"]) == ("form", form))
    figures: Mapping[str, Any] = next(own)["figures"]
    return figures


def _load(path: Path) -> list[Mapping[str, Any]]:
    return json.loads(path.read_text())["results"]


if __name__ == "__main__":
    main()
