"""Published figures of drivers have intervals over tracks, which follow from the saved results."""

from statistics import fmean

import pytest

from stkzoo.evaluation import load_benchmark
from stkzoo.suite.report.statistics import estimate_t
from tests.support.paths import ROOT

#: Display names of the drivers on the page of results, by their saved results.
ROWS = {
    "zenith": "*zenith*",
    "apex": "*apex*",
    "ace": "*ace*",
    "heuristic": "*heuristic*",
    "scout": "*scout*",
    "ai": "the game's AI",
}
COLUMNS = 8


def over_tracks(name):
    """Returns time ratio and share of races won against four AI karts, as texts with intervals."""
    result = load_benchmark(ROOT / "benchmarks" / "results" / "benchmark" / f"{name}.json")

    def estimate(races, figure):
        by_track = [[figure(r) for r in races if r.track == track] for track in result.plan.tracks]
        return estimate_t([fmean(values) for values in by_track])

    ratio = estimate(result.races, lambda race: race.time_ratio)
    won = estimate([r for r in result.races if r.form == "PAAAA"], lambda race: race.is_won)
    low, high = (100 * end for end in won.interval)
    return f"{ratio.low:.3f}..{ratio.high:.3f}", f"{low:.0f}..{high:.0f}", f"{100 * won.value:.0f}%"


def test_the_first_page_has_the_interval_over_tracks():
    _, ends, value = over_tracks("zenith")
    low, high = ends.split("..")
    text = " ".join((ROOT / "README.md").read_text().split())
    assert f"wins {value} of its races" in text
    assert f"({low} to {high}% over tracks)" in text


@pytest.mark.parametrize("name", ROWS)
def test_the_table_of_drivers_has_intervals_over_tracks(name):
    ratio, won, value = over_tracks(name)
    page = (ROOT / "docs" / "explanation" / "learning.md").read_text()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines()]
    (cells,) = (row for row in rows if row[0] == ROWS[name] and len(row) == COLUMNS)
    assert cells[3] == ratio
    assert cells[4].startswith(value)
    assert cells[5] == won
    if name in ("zenith", "apex", "ace", "scout"):
        card = (ROOT / "agents" / "pretrained" / name / "CARD.md").read_text()
        assert f"{ratio}) and" in card
        assert f"{value} ({won}) against four" in card
