"""The page of a league: rating curves, standings, and head-to-head results."""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Mapping, Sequence

from stkzoo._imports import import_extra
from stkzoo.evaluation import INK

from ..common.matches import AI, MatchRecord, payoff
from ..plot import rating_figure
from .players import START, LeagueMember

#: Maximum number of rows of the matrix.
_MOST_ROWS = 16
#: References to other pages in the SVG of a chart; inline SVG in HTML does not need them.
_LINKS = re.compile(r' xmlns(:xlink)?="[^"]*"|<metadata>.*?</metadata>', re.DOTALL)

_STYLE = """
:root{color-scheme:light dark;--ink:#1d2733;--soft:#5b6875;--paper:#fff;--line:#dfe4e9;
--good:31,111,191;--bad:194,87,26}
@media(prefers-color-scheme:dark){:root{--ink:#e6ebf0;--soft:#9aa7b4;--paper:#14191f;--line:#2c3641;
--good:109,177,242;--bad:240,147,90}}
*{box-sizing:border-box}
body{margin:0 auto;max-width:62rem;padding:1.2rem 1rem 3rem;background:var(--paper);
color:var(--ink);font:16px/1.5 system-ui,sans-serif}
h1{font-size:1.5rem;margin:.2rem 0}h2{font-size:1.1rem;margin:2rem 0 .4rem}
p{color:var(--soft);margin:.2rem 0 .8rem}
svg{width:100%;height:auto;display:block}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums}
th{font-weight:500;text-align:left;white-space:nowrap;padding:.25rem .5rem}
td{padding:.25rem .5rem;text-align:right;white-space:nowrap}
.standing tr{border-top:1px solid var(--line)}
.who th:first-child{position:sticky;left:0;background:var(--paper)}
.who thead th{vertical-align:bottom}
.who thead th+th{writing-mode:vertical-rl;transform:rotate(180deg);padding:.5rem .25rem}
.who td{text-align:center;min-width:2.6rem}
"""


def page(
    members: Sequence[LeagueMember],
    matches: Sequence[MatchRecord],
    ratings: Mapping[str, Sequence[float]],
) -> str:
    """Returns the page as self-contained HTML.

    Args:
        members: members of the league with ``name``, ``player``, ``kart_steps`` and
            ``league_steps``.
        matches: matches so far.
        ratings: rating, lower and upper end of its interval by name, including the game's AI.
    """
    players = sorted({member.player for member in members} - {""}, key=_kind)
    steps = max((member.league_steps for member in members), default=0)
    shown = _shown(members, ratings)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>League</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<style>{_STYLE}</style></head><body>
<h1>League</h1>
<p>{steps:,} kart-steps, {len(members)} members, {len(matches)} matches of up to four members and
one of the game's AI at its hardest.</p>
<h2>Ratings</h2>
<p>Plackett-Luce ratings from the finishing orders of all matches; 25 is the mean, and bands are 95%
intervals. Each point is a past self, at the kart-steps of the league when it was saved.</p>
{_chart(members, players, ratings)}
<h2>Who beats whom</h2>
<p>How often the member of the row finished ahead of the member of the column [%].</p>
<div class="wide">{_matrix(shown, matches)}</div>
<h2>Standings</h2>
<div class="wide">{_standings(members, ratings)}</div>
</body></html>
"""


def _kind(player: str) -> tuple[int, str]:
    order = ("main", "exploiter", "league")
    return order.index(player.partition("-")[0]), player


def _shown(members: Sequence[LeagueMember], ratings: Mapping[str, Sequence[float]]) -> list[str]:
    """Returns names for the matrix, best first: the start, the AI, and evenly chosen others."""
    newest = {member.player: member.name for member in members if member.player}
    others = [m.name for m in members if m.player and m.name not in newest.values()]
    count = max(_MOST_ROWS - 2 - len(newest), 1)
    if len(others) > count:
        others = [others[math.floor(number * len(others) / count)] for number in range(count)]
    first = [member.name for member in members if not member.player]
    names = {name for name in (*first, AI, *newest.values(), *others) if name in ratings}
    return sorted(names, key=lambda name: -ratings[name][0])


# ---------------------------------------------------------------------- the chart


def _chart(
    members: Sequence[LeagueMember],
    players: Sequence[str],
    ratings: Mapping[str, Sequence[float]],
) -> str:
    """Returns an SVG of the ratings over kart-steps in the page's colors."""
    curves: dict[str, list[tuple[float, Sequence[float]]]] = {player: [] for player in players}
    for member in members:
        if member.player and member.name in ratings:
            at = member.league_steps / 1e6
            curves[member.player].append((at, ratings[member.name]))
    names = {START: "start", AI: "the AI"}
    levels = {shown: ratings[name][0] for name, shown in names.items() if name in ratings}
    text = io.StringIO()
    # Keeps the page of the same league identical.
    settings = {"svg.fonttype": "none", "svg.hashsalt": "league"}
    with import_extra("matplotlib", "the page needs", "tournament").rc_context(settings):
        figure = rating_figure(curves, levels)
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    chart = text.getvalue()
    label = 'role="img" aria-label="Rating of each player over the league\'s kart-steps"'
    chart = chart[chart.index("<svg") :].replace("<svg", f"<svg {label}", 1)
    return _LINKS.sub("", chart).replace(INK, "var(--ink)")


# ---------------------------------------------------------------------- tables


def _matrix(names: Sequence[str], matches: Sequence[MatchRecord]) -> str:
    head = "".join(f'<th scope="col">{html.escape(name)}</th>' for name in names)
    rows = []
    for one in names:
        cells = "".join(_cell(one, other, matches) for other in names)
        rows.append(f'<tr><th scope="row">{html.escape(one)}</th>{cells}</tr>')
    return (
        f'<table class="who"><thead><tr><th></th>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _cell(one: str, other: str, matches: Sequence[MatchRecord]) -> str:
    if one == other:
        return "<td></td>"
    share, count = payoff(one, other, matches)
    if not count:
        return '<td title="they have not met">&middot;</td>'
    color = "good" if share >= 0.5 else "bad"
    depth = 0.12 + 0.9 * abs(share - 0.5)
    title = html.escape(f"{one} ahead of {other}: {share:.0%} of {count}")
    return (
        f'<td title="{title}" style="background:rgba(var(--{color}),{depth:.2f})">'
        f"{100 * share:.0f}</td>"
    )


def _standings(members: Sequence[LeagueMember], ratings: Mapping[str, Sequence[float]]) -> str:
    steps = {member.name: member.kart_steps for member in members}
    rows = []
    for place, name in enumerate(sorted(ratings, key=lambda name: -ratings[name][0]), 1):
        value, low, high = ratings[name]
        learned = f"{steps[name]:,}" if steps.get(name) else ""
        rows.append(
            f'<tr><td>{place}</td><th scope="row">{html.escape(name)}</th>'
            f"<td>{value:.1f} ({low:.1f} to {high:.1f})</td><td>{learned}</td></tr>"
        )
    return (
        '<table class="standing"><thead><tr><th></th><th>member</th><th>rating (interval)</th>'
        f"<th>kart-steps learned from</th></tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )
