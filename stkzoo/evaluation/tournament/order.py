"""One race of a tournament, with agents of servers."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from stkzoo.drivers.driver import Driver
from stkzoo.evaluation.batch.entrants import NAME_MARK
from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.race.remote import ServedAgent, ServerAccess
from stkzoo.race.result import RaceResult
from stkzoo.race.runner import run_race


@dataclass(frozen=True, slots=True)
class TournamentOrder(RaceOrder):
    """One race of a tournament.

    Attributes:
        served: for each driver the agent of a server, or ``None``.
        access: how to reach the servers.
    """

    served: tuple[ServedAgent | None, ...] = ()
    access: ServerAccess | None = None

    def run(self, folder: Path) -> RaceResult:  # noqa: ARG002 - as the base class
        """Runs the race, in a worker process."""
        with ExitStack() as resources:
            return run_race(
                self._all_drivers(resources),
                start_positions=range(1, len(self.drivers) + 1),
                settings=self.settings,
            )

    def _all_drivers(self, resources: ExitStack) -> list[str | Driver]:
        """The drivers, connected as long as ``resources`` lasts."""
        remote = [agent for agent in self.served if agent]
        if not remote:
            return [*self.drivers]
        group = resources.enter_context((self.access or ServerAccess()).connect(remote))
        connected = iter(group.drivers)
        return [
            replace(next(connected), name=text.rpartition(NAME_MARK)[2]) if agent else text
            for text, agent in zip(self.drivers, self.served, strict=True)
        ]
