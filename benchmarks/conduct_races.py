"""The races of ``benchmarks.conduct``, which worker processes run and judge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from stkzoo.evaluation.batch.order import RaceOrder
from stkzoo.race import RaceSettings
from stkzoo.race.replay import ReplayWriter
from stkzoo.suite import RaceConduct, race_conduct
from stkzoo.tracks import TRAIN_TRACKS

RAMMER = "benchmarks.rammer"
#: The drivers of each group of races; the game's AI always drives at the same difficulty. The
#: victims of the first group avoid other karts; those of the second ignore them.
GROUPS = {
    "rammer": (RAMMER, "pretrained:ace", "ai", "pretrained:scout", "ai", "pretrained:apex"),
    "rammer_and_blind": (RAMMER, "heuristic", "pursuit", "heuristic", "pursuit"),
    "ordinary": (
        *("heuristic", "pretrained:ace", "pretrained:scout", "pretrained:apex", "pursuit", "ai"),
    ),
}
#: Races last 40 s; later the rammer has lost contact with the others.
_STEPS = 400
_DIRECTIONS = 2
#: First seed; the rule for faults and the definition of a ram were chosen with other seeds.
_FIRST_SEED = 5000


@dataclass(frozen=True, slots=True)
class JudgedRaceOrder(RaceOrder):
    """A race to run and judge."""

    def run(self, folder: Path) -> RaceConduct:
        """Runs the race, stores its replay and judges it.

        Args:
            folder: folder of the replays.
        """
        replay = self.replay_file(folder)
        replay.parent.mkdir(parents=True, exist_ok=True)
        self.race(self.drivers, [ReplayWriter(replay)])
        rammers = [number for number, name in enumerate(self.drivers) if name == RAMMER]
        return replace(race_conduct(replay, rammers or None), replay=replay.name)


def orders(group: str, races: int) -> list[JudgedRaceOrder]:
    """Returns races on all training tracks in both directions, from all places of the grid.

    Args:
        group: name of the group of races.
        races: number of races.
    """
    return [_order(GROUPS[group], number) for number in range(races)]


def _order(drivers: Sequence[str], number: int) -> JudgedRaceOrder:
    # With equal track, direction and grid, races with different seeds begin identically.
    turn = (number + number // (_DIRECTIONS * len(TRAIN_TRACKS))) % len(drivers)
    lap, place = divmod(number, len(TRAIN_TRACKS))
    settings = RaceSettings(
        track=TRAIN_TRACKS[place],
        reverse=(lap + place) % _DIRECTIONS == 1,
        seed=_FIRST_SEED + number,
        difficulty=3,
        max_steps=_STEPS,
        inline=True,
    )
    return JudgedRaceOrder(number, (*drivers[turn:], *drivers[:turn]), settings)
