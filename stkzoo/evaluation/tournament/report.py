"""The report of a tournament: one page without scripts, and tables as CSV.

The page, ``report.html``, loads no other files, and its content security policy forbids scripts and
requests. Agents control their names and error texts, so the template escapes all texts.
"""

from __future__ import annotations

import csv
import io
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from stkzoo._os import write_text
from stkzoo.evaluation.batch.order import replay_file
from stkzoo.evaluation.templates import render
from stkzoo.evaluation.tournament.film import MapFilm, draw_film, film_file
from stkzoo.evaluation.tournament.standings import Standing, TournamentResult, races_of
from stkzoo.race.result import AgentResult, RaceResult

_FILMS = 6
_MAX_TRACE = 4000  # characters
_KINDS = {"start": "could not be loaded", "timeout": "took too long", "error": "raised an error"}
#: Prefixes with which a spreadsheet interprets a cell as a formula.
_FORMULA = ("=", "+", "-", "@")


@dataclass(frozen=True)
class TournamentReport:
    """The page and tables of a tournament.

    Attributes:
        folder: folder of the tournament.
        result: result of the tournament.
        races: results of its races by number.
        is_public: whether to leave out error messages, tracebacks, addresses, paths and replays.
        title: heading of the page.
    """

    folder: Path
    result: TournamentResult
    races: Mapping[int, RaceResult]
    is_public: bool = False
    title: str = "Tournament"

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
        head = ("place", "agent", *names[2:], "rating", "low", "high", "reason", "group", "source")
        rows = [
            (
                *(getattr(row, name) for name in names),
                *(row.rating.value, row.rating.low, row.rating.high, self.reason_of(row), group),
                "" if self.is_public else row.source,
            )
            for row, group in zip(self.result.standings, self.result.groups, strict=True)
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
                self.error_of(row),
            )
            for number, race in sorted(self.races.items())
            for place, row in self.placed(number)
        ]
        return _csv([head, *rows])

    # ------------------------------------------------------------------ the page

    def page(self) -> str:
        """Returns the page as HTML.

        Raises:
            ConfigError: Jinja is not installed.
        """
        return render(
            Path(__file__).with_name("report.html"),
            report=self,
            result=self.result,
            plan=self.result.plan,
            standings=self.result.standings,
            films=list(self._films()),
        )

    def _films(self) -> Iterator[tuple[int, str, str, dict[str, str]]]:
        """Yields number, track, picture and colors of the races of the best agents."""
        value = {row.label: row.rating.value for row in self.result.standings}
        best = sorted(
            self.result.races, key=lambda race: -fmean(value[name] for name in race.order)
        )
        for race in best[:_FILMS]:
            if (file := film_file(self.folder, race.number)).exists():
                yield race.number, race.track, *draw_film(MapFilm.load(file), f"film-{race.number}")

    # ------------------------------------------------------------------ parts

    def placed(self, number: int) -> list[tuple[int, AgentResult]]:
        """Returns the places in a race as in the standings, where failed agents are last."""
        summary = next(race for race in self.result.races if race.number == number)
        rows = self.races[number].agents
        in_order = sorted(rows, key=lambda row: summary.order.index(row.driver))
        return [(summary.place_of(row.driver), row) for row in in_order]

    def driven_by(self, label: str) -> list[tuple[int, int, AgentResult]]:
        """Returns the number, the place and the result of each race of an agent."""
        driven = races_of(label, self.result.races, self.races)
        return [(race.number, place, row) for race, place, row in driven]

    def replay(self, number: int) -> str:
        """Returns the path of a race's replay; empty without one, and for the public."""
        file = replay_file(self.folder, number)
        is_linked = file.exists() and not self.is_public
        return file.relative_to(self.folder).as_posix() if is_linked else ""

    def trace_of(self, label: str) -> str:
        """Returns the end of an agent's first traceback; empty without one, and for the public."""
        rows = [] if self.is_public else [row for *_, row in self.driven_by(label) if row.errors]
        return next((row.errors[0].trace[-_MAX_TRACE:] for row in rows if row.errors[0].trace), "")

    def error_of(self, row: AgentResult) -> str:
        """Returns an agent's first failure in a race as one line; empty without failures."""
        if not row.errors:
            return ""
        first = row.errors[0]
        problem = _KINDS.get(first.kind, "failed")
        return problem if self.is_public else f"{problem}: {' '.join(first.message.split())[:200]}"

    def reason_of(self, row: Standing) -> str:
        """Returns an agent's most frequent failure; for the public, only its kind."""
        if not self.is_public or not row.reason:
            return row.reason
        errors = (self.error_of(entry) for *_, entry in self.driven_by(row.label))
        return next(filter(None, errors), "")


def _csv(rows: Iterable[Sequence[object]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def _cell(value: object) -> object:
    """Returns a text as one line, after a quote if a spreadsheet would run it as a formula."""
    if not isinstance(value, str):
        return value
    line = " ".join(value.split())  # some programs begin a row after a carriage return
    return f"'{line}" if unicodedata.normalize("NFKC", line[:1]).startswith(_FORMULA) else line
