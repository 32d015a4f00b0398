"""Plots show the names of agents as they are, and axes keep their formulas."""

from dataclasses import replace

from stkzoo.evaluation import load_benchmark, new_figure, plot_benchmark, plotting, save_figure
from stkzoo.evaluation.plotting import draw_intervals
from stkzoo.evaluation.statistics import Estimate
from tests.support.paths import ROOT


def test_a_plot_of_races_without_rivals_has_no_empty_half(tmp_path):
    result = load_benchmark(ROOT / "benchmarks/results/benchmark/heuristic.json")
    alone = replace(result, races=tuple(race for race in result.races if race.form == "P"))
    for drawn, has_rivals in ((result, True), (alone, False)):
        plot_benchmark(drawn, tmp_path / "plot.svg")
        assert ("Races won" in (tmp_path / "plot.svg").read_text()) == has_rivals


def test_dollar_signs_in_names_are_no_formulas(tmp_path):
    name = r"$\bad{x$"
    figure = new_figure(4, 3)
    axes = figure.subplots()
    axes.plot([1, 10], [1, 1000], label=name)
    axes.set_title(name)
    axes.set_xticks([1, 10], [name, "other"])
    axes.set_yscale("log")
    axes.legend()
    save_figure(figure, tmp_path / "plot.svg")
    drawn = (tmp_path / "plot.svg").read_text()
    assert drawn.count(f"<!-- {name} -->") == 3
    assert r"mathdefault{10^{2}}" in drawn


def test_letters_that_the_font_lacks_are_written_in_installed_fonts(tmp_path, monkeypatch):
    monkeypatch.setattr(plotting, "_FALLBACK_FONTS", ("No Such Font", "DejaVu Serif"))
    figure = new_figure(4, 3)
    title = figure.subplots().set_title("\u540d\u524d")
    save_figure(figure, tmp_path / "plot.png")
    assert title.get_fontfamily() == ["sans-serif", "DejaVu Serif"]


def test_a_legend_shows_names_with_an_underscore():
    axes = new_figure(4, 3).subplots()
    for row, name in enumerate(["_bot", "other"]):
        draw_intervals(axes, {row: Estimate(1.0, 0.9, 1.1)}, label=name)
    _, labels = axes.get_legend_handles_labels()
    assert [label.strip() for label in labels] == ["_bot", "other"]
