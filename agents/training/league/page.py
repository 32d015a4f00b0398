"""A league as one page: rating curves, standings, and who beats whom."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from typing import Any

from ..common.matches import MatchRecord
from .matches import AI, payoff

#: Rows of the matrix at most.
_MOST_ROWS = 16
_WIDTH, _HEIGHT = 720, 360
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 12, 14, 60
_DASHES = ("", "7 4", "2 3", "9 3 2 3")

_STYLE = """
:root{color-scheme:light dark;--ink:#1d2733;--soft:#5b6875;--paper:#fff;--line:#dfe4e9;
--c0:#1f6fbf;--c1:#c2571a;--c2:#7a4fb5;--c3:#2b8a57;--good:31,111,191;--bad:194,87,26}
@media(prefers-color-scheme:dark){:root{--ink:#e6ebf0;--soft:#9aa7b4;--paper:#14191f;--line:#2c3641;
--c0:#6db1f2;--c1:#f0935a;--c2:#b79af0;--c3:#6ccb98;--good:109,177,242;--bad:240,147,90}}
*{box-sizing:border-box}
body{margin:0 auto;max-width:62rem;padding:1.2rem 1rem 3rem;background:var(--paper);
color:var(--ink);font:16px/1.5 system-ui,sans-serif}
h1{font-size:1.5rem;margin:.2rem 0}h2{font-size:1.1rem;margin:2rem 0 .4rem}
p{color:var(--soft);margin:.2rem 0 .8rem}
svg{width:100%;height:auto;display:block}
svg text{fill:var(--soft);font-size:13px;paint-order:stroke;stroke:var(--paper);stroke-width:4px}
svg .grid{stroke:var(--line)}
@media(max-width:36rem){svg text{font-size:22px}svg circle{r:5px}}
.keys{display:flex;flex-wrap:wrap;gap:.2rem 1.2rem;font-size:.9rem}
.keys svg{width:34px;height:12px;display:inline-block;vertical-align:middle;margin-right:.4rem}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.85rem;font-variant-numeric:tabular-nums}
th{font-weight:500;text-align:left;white-space:nowrap;padding:.25rem .5rem}
td{padding:.25rem .5rem;text-align:right;white-space:nowrap}
.standing tr{border-top:1px solid var(--line)}
.who th:first-child{position:sticky;left:0;background:var(--paper)}
.who thead th{vertical-align:bottom}
.who thead th+th{writing-mode:vertical-rl;transform:rotate(180deg);padding:.5rem .25rem}
.who td{text-align:center;min-width:2.6rem}
.of0{color:var(--c0)}.of1{color:var(--c1)}.of2{color:var(--c2)}.of3{color:var(--c3)}
"""


def page(
    members: Sequence[Mapping[str, Any]],
    matches: Sequence[MatchRecord],
    ratings: Mapping[str, Sequence[float]],
) -> str:
    """The page as self-contained HTML.

    Args:
        members: of the league: ``name``, ``player``, ``kart_steps`` and ``league_steps`` of each.
        matches: those that were played.
        ratings: value, low and high end of the interval by name; the game's AI is there too.
    """
    players = sorted({str(member["player"]) for member in members} - {""}, key=_kind)
    steps = max((int(member["league_steps"]) for member in members), default=0)
    shown = _shown(members, ratings)
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>League</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<style>{_STYLE}</style></head><body>
<h1>League</h1>
<p>{steps:,} kart-steps, {len(members)} members, {len(matches)} matches of up to four members and
one of the game's AI at its hardest.</p>
<h2>Ratings</h2>
<p>Plackett-Luce, of the orders of all matches; 25 is the mean, the bands are 95 % intervals. Each
point is a past self, where the league was when it was kept.</p>
{_keys(players)}
{_chart(members, players, ratings)}
<h2>Who beats whom</h2>
<p>In how many of their matches the row was before the column [%].</p>
<div class="wide">{_matrix(shown, matches)}</div>
<h2>Standings</h2>
<div class="wide">{_standings(members, players, ratings)}</div>
</body></html>
"""


def _kind(player: str) -> tuple[int, str]:
    order = ("main", "exploiter", "league")
    return order.index(player.partition("-")[0]), player


def _shown(
    members: Sequence[Mapping[str, Any]], ratings: Mapping[str, Sequence[float]]
) -> list[str]:
    """Names for the matrix, best first: what all began from, the AI, the others evenly."""
    newest = {str(member["player"]): str(member["name"]) for member in members if member["player"]}
    others = [str(m["name"]) for m in members if m["player"] and m["name"] not in newest.values()]
    count = max(_MOST_ROWS - 2 - len(newest), 1)
    if len(others) > count:
        others = [others[math.floor(number * len(others) / count)] for number in range(count)]
    first = [str(member["name"]) for member in members if not member["player"]]
    names = {name for name in (*first, AI, *newest.values(), *others) if name in ratings}
    return sorted(names, key=lambda name: -ratings[name][0])


# ---------------------------------------------------------------------- the chart


def _keys(players: Sequence[str]) -> str:
    keys = [
        f'<span><svg viewBox="0 0 34 12"><path d="M0 6H34" {_stroke(n)}/></svg>'
        f"{html.escape(player)}</span>"
        for n, player in enumerate(players)
    ]
    return f'<div class="keys">{"".join(keys)}</div>'


def _stroke(number: int) -> str:
    dash = _DASHES[number // 4 % len(_DASHES)]
    return f'fill="none" stroke="var(--c{number % 4})" stroke-width="2.2" stroke-dasharray="{dash}"'


def _chart(
    members: Sequence[Mapping[str, Any]],
    players: Sequence[str],
    ratings: Mapping[str, Sequence[float]],
) -> str:
    rated = [member for member in members if member["name"] in ratings]
    most = max((int(member["league_steps"]) for member in rated), default=0) or 1
    everything = [value for rating in ratings.values() for value in rating]
    low, high = math.floor(min(everything)), math.ceil(max(everything))

    def x(steps: float) -> float:
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * steps / most

    def y(rating: float) -> float:
        return _TOP + (_HEIGHT - _TOP - _BOTTOM) * (high - rating) / max(high - low, 1)

    parts = [_axes(x, y, most, low, high)]
    anchors = [name for name in ("start", AI) if name in ratings]
    for number, player in enumerate(players):
        own = [member for member in rated if member["player"] == player]
        points = [_point(x(int(m["league_steps"])), y, ratings[m["name"]]) for m in own]
        parts.append(_curve(number, points, [str(m["name"]) for m in own], ratings))
    parts += [_anchor(name, y(ratings[name][0])) for name in anchors]
    label = "Rating of each player over the league's kart-steps"
    view = f"0 0 {_WIDTH} {_HEIGHT}"
    return f'<svg viewBox="{view}" role="img" aria-label="{label}">{"".join(parts)}</svg>'


def _point(x: float, y: Any, rating: Sequence[float]) -> tuple[float, float, float, float]:
    value, low, high = rating
    return x, y(value), y(low), y(high)


def _axes(x: Any, y: Any, most: int, low: int, high: int) -> str:
    step = max(1, math.ceil((high - low) / 8))
    parts = [
        f'<path class="grid" d="M{_LEFT} {y(value):.1f}H{_WIDTH - _RIGHT}"/>'
        f'<text x="{_LEFT - 6}" y="{y(value) + 4:.1f}" text-anchor="end">{value}</text>'
        for value in range(low, high + 1, step)
    ]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        steps = share * most
        anchor = "end" if share == 1 else "middle"
        parts.append(
            f'<text x="{x(steps):.1f}" y="{_HEIGHT - _BOTTOM + 24}" text-anchor="{anchor}">'
            f"{_thousands(steps)}</text>"
        )
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    parts.append(
        f'<text x="{middle}" y="{_HEIGHT - 6}" text-anchor="middle">kart-steps of the league</text>'
    )
    return "".join(parts)


def _thousands(steps: float) -> str:
    return f"{steps / 1e6:.1f} M" if steps >= 1e6 else f"{steps / 1e3:.0f} k"


def _anchor(name: str, height: float) -> str:
    text = {"start": "what all began from", AI: "the game's AI"}[name]
    return (
        f'<path d="M{_LEFT} {height:.1f}H{_WIDTH - _RIGHT}" stroke="var(--soft)" '
        f'stroke-dasharray="1 4"/><text x="{_WIDTH - _RIGHT}" y="{height + 5:.1f}" '
        f'text-anchor="end">{text}</text>'
    )


def _curve(
    number: int,
    points: Sequence[tuple[float, float, float, float]],
    names: Sequence[str],
    ratings: Mapping[str, Sequence[float]],
) -> str:
    """A player's curve with its band; a point is x and the heights of value, low and high."""
    band = [(x, high) for x, _, _, high in points] + [(x, low) for x, _, low, _ in points[::-1]]
    line = "M" + "L".join(f"{x:.1f} {value:.1f}" for x, value, _, _ in points)
    edge = " ".join(f"{x:.1f},{height:.1f}" for x, height in band)
    dots = [
        f'<circle cx="{x:.1f}" cy="{value:.1f}" r="3.5" fill="var(--c{number % 4})">'
        f"<title>{html.escape(name)}: {_interval(ratings[name])}</title></circle>"
        for (x, value, _, _), name in zip(points, names, strict=True)
    ]
    return (
        f'<polygon points="{edge}" fill="var(--c{number % 4})" opacity=".13"/>'
        f'<path d="{line}" {_stroke(number)}/>{"".join(dots)}'
    )


def _interval(rating: Sequence[float]) -> str:
    return f"{rating[0]:.1f} ({rating[1]:.1f} to {rating[2]:.1f})"


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
    colour = "good" if share >= 0.5 else "bad"
    depth = 0.12 + 0.9 * abs(share - 0.5)
    title = html.escape(f"{one} before {other}: {share:.0%} of {count}")
    return (
        f'<td title="{title}" style="background:rgba(var(--{colour}),{depth:.2f})">'
        f"{100 * share:.0f}</td>"
    )


def _standings(
    members: Sequence[Mapping[str, Any]],
    players: Sequence[str],
    ratings: Mapping[str, Sequence[float]],
) -> str:
    steps = {str(member["name"]): int(member["kart_steps"]) for member in members}
    of_player = {str(member["name"]): str(member["player"]) for member in members}
    rows = []
    for place, name in enumerate(sorted(ratings, key=lambda name: -ratings[name][0]), 1):
        player = of_player.get(name, "")
        colour = f' class="of{players.index(player) % 4}"' if player else ""
        learned = f"{steps[name]:,}" if player else ""
        rows.append(
            f'<tr><td>{place}</td><th scope="row"{colour}>{html.escape(name)}</th>'
            f"<td>{_interval(ratings[name])}</td><td>{learned}</td></tr>"
        )
    return (
        '<table class="standing"><thead><tr><th></th><th>member</th><th>rating (interval)</th>'
        f"<th>kart-steps learned from</th></tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )
