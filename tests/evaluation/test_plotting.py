"""Plots show the names of agents as they are, and axes keep their formulas."""

from stkzoo.evaluation import new_figure, save_figure


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
