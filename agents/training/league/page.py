"""The page of a league: rating curves, standings, and head-to-head results."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stkzoo._imports import import_extra
from stkzoo.evaluation import INK, render

from ..common.matches import AI, MatchRecord, payoff
from ..plot import rating_figure
from .players import START, LeagueMember

#: Maximum number of rows of the matrix.
_MOST_ROWS = 16
#: References to other pages in the SVG of a chart; inline SVG in HTML does not need them.
_LINKS = re.compile(r' xmlns(:xlink)?="[^"]*"|<metadata>.*?</metadata>', re.DOTALL)


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
    names = _shown(members, ratings)
    steps = {member.name: member.kart_steps for member in members}
    best = sorted(ratings, key=lambda name: -ratings[name][0])
    return render(
        Path(__file__).with_name("page.html"),
        steps=max((member.league_steps for member in members), default=0),
        members=members,
        matches=matches,
        chart=_chart(members, ratings),
        names=names,
        cells={one: [_cell(one, other, matches) for other in names] for one in names},
        standings=[(name, ratings[name], steps.get(name)) for name in best],
    )


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


def _chart(members: Sequence[LeagueMember], ratings: Mapping[str, Sequence[float]]) -> str:
    """Returns an SVG of the ratings over kart-steps in the page's colors."""
    curves: dict[str, list[tuple[float, Sequence[float]]]] = {}
    for member in members:
        if member.player and member.name in ratings:
            point = member.league_steps / 1e6, ratings[member.name]
            curves.setdefault(member.player, []).append(point)
    names = {START: "start", AI: "the AI"}
    levels = {shown: ratings[name][0] for name, shown in names.items() if name in ratings}
    text = io.StringIO()
    # Keeps the page of the same league identical.
    settings = {"svg.fonttype": "none", "svg.hashsalt": "league"}
    with import_extra("matplotlib", "the page needs", "races").rc_context(settings):
        figure = rating_figure(curves, levels)
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    chart = text.getvalue()
    label = 'role="img" aria-label="Rating of each player over the league\'s kart-steps"'
    chart = chart[chart.index("<svg") :].replace("<svg", f"<svg {label}", 1)
    return _LINKS.sub("", chart).replace(INK, "var(--ink)")


def _cell(one: str, other: str, matches: Sequence[MatchRecord]) -> dict[str, Any] | None:
    """Returns how often one member is ahead of another; ``None`` for the same member."""
    if one == other:
        return None
    share, count = payoff(one, other, matches)
    depth = 0.12 + 0.9 * abs(share - 0.5)
    return {"other": other, "share": share, "count": count, "depth": f"{depth:.2f}"}
