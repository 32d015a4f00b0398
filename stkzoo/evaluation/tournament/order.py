"""One race of a tournament, which can include agents on servers and stores a replay and a film."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from stkzoo._os import write_text
from stkzoo.drivers.driver import Driver
from stkzoo.evaluation.batch.entrants import NAME_MARK
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.evaluation.tournament.film import FilmRecorder
from stkzoo.race.remote import ServedAgent, ServerAccess
from stkzoo.race.replay import ReplayWriter
from stkzoo.race.result import RaceResult


@dataclass(frozen=True, slots=True)
class TournamentOrder(RaceOrder):
    """One race of a tournament.

    Attributes:
        served: for each driver, its agent on a server; ``None`` for a driver that runs here.
        access: how to connect to the servers.
    """

    served: tuple[ServedAgent | None, ...] = ()
    access: ServerAccess | None = None

    def run(self, folder: Path) -> RaceResult:
        """Runs the race in a worker process, and stores its replay and film.

        Args:
            folder: folder of the tournament.
        """
        replay, film = self.replay_file(folder), film_file(folder, self.number)
        for file in (replay, film):
            file.parent.mkdir(exist_ok=True)
        recorder = FilmRecorder()
        with ExitStack() as resources:
            drivers = self._all_drivers(resources)
            result = self.race(drivers, [recorder, ReplayWriter(replay)])
        write_text(film, recorder.film().to_json())
        return result

    def suspects(self) -> tuple[int, ...]:
        """See :meth:`RaceOrder.suspects`. Agents on servers run elsewhere, so they are excluded."""
        here = replace(
            self,
            drivers=tuple(
                "ai" if agent else text
                for text, agent in zip(self.drivers, self.served, strict=True)
            ),
        )
        return RaceOrder.suspects(here)

    def _all_drivers(self, resources: ExitStack) -> list[str | Driver]:
        """Returns the drivers. Connections to servers are closed with ``resources``."""
        remote = [agent for agent in self.served if agent]
        if not remote:
            return [*self.drivers]
        group = resources.enter_context((self.access or ServerAccess()).connect(remote))
        connected = iter(group.drivers)
        return [
            replace(next(connected), name=text.rpartition(NAME_MARK)[2]) if agent else text
            for text, agent in zip(self.drivers, self.served, strict=True)
        ]


def film_file(folder: Path, number: int) -> Path:
    """Returns the file of a race's film in the tournament's folder."""
    return folder / "films" / f"{number:05d}.json"
