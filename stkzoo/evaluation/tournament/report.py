"""The report of a tournament: one page without scripts, and tables as CSV.

The page loads no other files, and its content security policy forbids scripts and requests. Agents
control their names and error texts, so :func:`html.escape` is applied to all of them.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from statistics import fmean

from stkzoo._os import write_text
from stkzoo.evaluation.batch.order import replay_file
from stkzoo.evaluation.tournament.film import MapFilm, draw_film, film_file
from stkzoo.evaluation.tournament.standings import RaceSummary, Standing, TournamentResult
from stkzoo.race.result import AgentResult, RaceResult

_POLICY = "default-src 'none'; style-src 'unsafe-inline'"
_FILMS = 6
_MAX_TRACE = 4000  # characters
_KINDS = {"start": "could not be loaded", "timeout": "took too long", "error": "raised an error"}
#: Prefixes with which a spreadsheet interprets a cell as a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class TournamentReport:
    """The page and tables of a tournament.

    Attributes:
        folder: folder of the tournament.
        result: result of the tournament.
        races: results of its races by number.
        is_public: whether to leave out error messages, tracebacks, addresses, paths and replays.
        title: heading of the page.
        films: numbers of the races with a film; ``None`` for races of the best agents.
    """

    folder: Path
    result: TournamentResult
    races: Mapping[int, RaceResult]
    is_public: bool = False
    title: str = "Tournament"
    films: Sequence[int] | None = None
    _places: dict[str, int] = field(init=False, default_factory=dict)
    _summaries: dict[int, RaceSummary] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self._places.update({row.label: row.place for row in self.result.standings})
        self._summaries.update({race.number: race for race in self.result.races})

    def write(self, page: Path) -> None:
        """Writes the page, and ``standings.csv`` and ``races.csv`` beside it.

        Args:
            page: file of the page.

        Raises:
            ConfigError: a file cannot be written.
        """
        write_text(page, self.page())
        write_text(page.with_name("standings.csv"), self.standings_csv())
        write_text(page.with_name("races.csv"), self.races_csv())

    # ------------------------------------------------------------------ tables

    def standings_csv(self) -> str:
        """Returns the standings as CSV, with one line per agent."""
        names = ("place", "label", "races", "wins", "mean_rank", "finished", "retired", "mean_time")
        head = ("place", "agent", *names[2:], "rating", "low", "high", "reason")
        rows = [
            (
                *(getattr(row, name) for name in names),
                *(row.rating.value, row.rating.low, row.rating.high, self._reason_of(row)),
            )
            for row in self.result.standings
        ]
        return _csv([head, *rows])

    def races_csv(self) -> str:
        """Returns all races as CSV, with one line per agent and race."""
        names = ("status", "finish_time", "distance", "num_errors")
        head = ("race", "track", "seed", "agent", "start_position", "rank", *names, "error")
        rows = [
            (
                *(number, race.track, race.seed, row.driver, row.start_position, place),
                *(getattr(row, name) for name in names),
                self._error_of(row),
            )
            for number, race in sorted(self.races.items())
            for place, row in self._placed(number)
        ]
        return _csv([head, *rows])

    # ------------------------------------------------------------------ the page

    def page(self) -> str:
        """Returns the page as HTML."""
        style = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
        parts = (self._standings(), self._matrix(), self._films(), self._agents())
        return (
            '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{escape(self.title)}</title>\n<style>\n{style}</style></head>\n<body>"
            f"<header>{self._header()}</header>\n" + "\n".join(parts) + "\n</body></html>\n"
        )

    def _header(self) -> str:
        plan, result = self.result.plan, self.result
        laps = "1 lap" if plan.settings.laps == 1 else f"{plan.settings.laps} laps"
        facts = (
            f"{len(result.standings)} agents",
            f"{len(result.races)} of {plan.num_races} races of {plan.grid_size}, {laps}",
            ", ".join(plan.tracks),
            f"stkzoo {plan.versions.get('stkzoo', '')}",
        )
        return f'<h1>{escape(self.title)}</h1><p class="facts">{escape(" · ".join(facts))}</p>'

    def _standings(self) -> str:
        rows = self.result.standings
        low = min(row.rating.interval[0] for row in rows)
        span = max(max(row.rating.interval[1] for row in rows) - low, 1e-6)
        lines = "".join(self._standing(row, low, span) for row in rows)
        return (
            '<section><h2>Standings</h2><div class="scroll"><table><thead><tr>'
            '<th class="n">#<th>Agent<th class="n">Rating<th class="chart">95% interval'
            '<th class="n wide">Wins'
            '<th class="n wide">Races<th class="n wide">Mean place<th class="n wide">Finished'
            f'<th class="n">Failed</tr></thead><tbody>{lines}</tbody></table></div>'
            '<p class="note">Plackett-Luce ratings; intervals by bootstrap over races. Agents '
            "whose intervals overlap may be equally good.</p></section>"
        )

    def _standing(self, row: Standing, low: float, span: float) -> str:
        least, most = row.rating.interval
        start, dot, end = (
            f"{100 * (value - low) / span:.1f}%" for value in (least, row.rating.value, most)
        )
        interval = f"{least:.1f} to {most:.1f}"
        rank = "" if row.mean_rank is None else f"{row.mean_rank:.2f}"
        failed = ' class="n failed"' if row.failed else ' class="n"'
        return (
            f'<tr><td class="n">{row.place}<td class="name">{self._link(row.label)}'
            f'<td class="n">{row.rating.value:.1f}'
            f'<td class="chart"><svg role="img" aria-label="{interval}"><title>{interval}</title>'
            f'<line x1="{start}" x2="{end}" y1="50%" y2="50%"/>'
            f'<circle cx="{dot}" cy="50%" r="4.5"/></svg>'
            f'<td class="n wide">{row.wins}<td class="n wide">{row.races}<td class="n wide">{rank}'
            f'<td class="n wide">{row.finished}<td{failed}>{row.failed}</tr>\n'
        )

    def _matrix(self) -> str:
        rows = self.result.standings
        head = "".join(
            f'<th title="{escape(row.label)}"><span>{row.place} {escape(row.label)}</span>'
            for row in rows
        )
        lines = "".join(
            f'<tr><th title="{escape(row.label)}">{row.place} {escape(row.label)}'
            + "".join(self._cell(one, two) for two in range(len(rows)))
            + "</tr>\n"
            for one, row in enumerate(rows)
        )
        return (
            "<section><h2>Head to head</h2>"
            '<p class="note">How often, in percent, the agent of the row finished ahead of the '
            "agent of the column. Hover over a cell for the numbers of races.</p>"
            f'<div class="scroll"><table class="matrix"><thead><tr><th>{head}</tr></thead><tbody>'
            f"{lines}</tbody></table></div></section>"
        )

    def _cell(self, one: int, two: int) -> str:
        share = self.result.payoff(one, two)
        if share is None:
            return "<td>"
        won, lost = self.result.ahead[one][two], self.result.ahead[two][one]
        names = (self.result.standings[number].label for number in (one, two))
        text = "{} beat {} in {} of {} races".format(*names, won, won + lost)
        side, strength = ("win" if share >= 0.5 else "lose"), abs(share - 0.5) * 1.5
        return (
            f'<td title="{escape(text)}" style="background:rgb(var(--{side}) / {strength:.2f})">'
            f"{100 * share:.0f}"
        )

    def _films(self) -> str:
        figures = [
            self._figure(number, MapFilm.load(file))
            for number in self._filmed()
            if (file := film_file(self.folder, number)).exists()
        ]
        if not figures:
            return ""
        return (
            '<section><h2>Races</h2><p class="note">Click a map to play the race at four times '
            f'its speed.</p><div class="films">{"".join(figures)}</div></section>'
        )

    def _filmed(self) -> Sequence[int]:
        if self.films is not None:
            return [number for number in self.films if number in self.races]
        value = {row.label: row.rating.value for row in self.result.standings}
        best = sorted(
            self.result.races, key=lambda race: -fmean(value[name] for name in race.order)
        )
        return [race.number for race in best[:_FILMS]]

    def _figure(self, number: int, film: MapFilm) -> str:
        race = self.races[number]
        picture, colors = draw_film(film, f"film-{number}")
        lines = "".join(
            f'<li><i class="dot" style="background:{colors.get(row.driver, "gray")}"></i>'
            f"{place}. {self._link(row.driver)} {escape(_outcome(row))}"
            for place, row in self._placed(number)
        )
        return (
            f"<figure>{picture}<figcaption><b>Race {number}</b>, {escape(race.track)}"
            f"{self._replay(number)}<ol>{lines}</ol></figcaption></figure>"
        )

    def _agents(self) -> str:
        sections = "".join(self._agent(row) for row in self.result.standings)
        return f"<section><h2>Agents</h2>{sections}</section>"

    def _agent(self, row: Standing) -> str:
        driven = [
            (number, race, place, entry)
            for number, race in sorted(self.races.items())
            for place, entry in self._placed(number)
            if entry.driver == row.label
        ]
        lines = "".join(
            f'<tr><td class="n">{number}<td>{escape(race.track)}<td class="n">{e.start_position}'
            f'<td class="n">{place} of {len(race.agents)}<td>{escape(_outcome(e))}'
            f"<td>{escape(self._error_of(e))}{self._replay(number)}</tr>"
            for number, race, place, e in driven
        )
        source = "" if self.is_public else f'<p class="note">{escape(row.source)}</p>'
        traces = [e.errors[0].trace for *_, e in driven if e.errors and e.errors[0].trace]
        trace = ""
        if traces and not self.is_public:
            trace = f"<pre>{escape(traces[0][-_MAX_TRACE:])}</pre>"
        reason = self._reason_of(row)
        times = f"failed in {row.failed} of {row.races} races"
        failed = f' <span class="failed">{times}: {escape(reason)}</span>'
        return (
            f"<details><summary><b>{row.place}. {escape(row.label)}</b>"
            f"<span>{row.wins} wins in {row.races} races</span>{failed if reason else ''}"
            f'</summary><div id="agent-{row.place}" class="scroll">{source}<table><thead><tr>'
            '<th class="n">Race<th>Track<th class="n">Start<th class="n">Place<th>Time<th>'
            f"</tr></thead><tbody>{lines}</tbody></table>{trace}</div></details>\n"
        )

    # ------------------------------------------------------------------ parts

    def _placed(self, number: int) -> list[tuple[int, AgentResult]]:
        """Returns the places in a race as in the standings, where failed agents are last."""
        summary, rows = self._summaries[number], self.races[number].agents
        in_order = sorted(rows, key=lambda row: summary.order.index(row.driver))
        return [(summary.place_of(row.driver), row) for row in in_order]

    def _link(self, label: str) -> str:
        return f'<a href="#agent-{self._places.get(label, 0)}">{escape(label)}</a>'

    def _replay(self, number: int) -> str:
        file = replay_file(self.folder, number)
        if self.is_public or not file.exists():
            return ""
        return f' <a href="{file.relative_to(self.folder).as_posix()}">replay</a>'

    def _error_of(self, row: AgentResult) -> str:
        """Returns an agent's first failure in a race as one line; empty without failures."""
        if not row.errors:
            return ""
        first = row.errors[0]
        problem = _KINDS.get(first.kind, "failed")
        return problem if self.is_public else f"{problem}: {' '.join(first.message.split())[:200]}"

    def _reason_of(self, row: Standing) -> str:
        if not self.is_public or not row.reason:
            return row.reason
        errors = (self._error_of(e) for r in self.races.values() for e in r.agents
                  if e.driver == row.label)  # fmt: skip
        return next(filter(None, errors), "")


def _outcome(row: AgentResult) -> str:
    if row.finish_time is not None:
        return f"{row.finish_time:.1f} s"
    return "failed" if row.status == "retired" else f"{row.distance:.0f} m"


def _csv(rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(_cells, rows))
    return text.getvalue()


def _cells(row: Sequence[object]) -> list[object]:
    """Returns a row in which a quote precedes texts that a spreadsheet would run as formulas."""
    return [f"'{v}" if isinstance(v, str) and v.startswith(_FORMULA) else v for v in row]
