"""The background population of the suite: frozen drivers that entries race against."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from stkzoo.drivers.driver import GAME_AI
from stkzoo.evaluation.benchmark.races import BenchmarkRace


@dataclass(frozen=True, slots=True)
class Member:
    """A driver of the population.

    Attributes:
        driver: its name for :func:`~stkzoo.race.find_driver`.
        digest: digest of the motion of all karts in a race of the driver, which a test computes.
            Every change of its decisions changes the digest.
        is_held_out: whether agents must not meet it during training.
    """

    driver: str
    digest: str
    is_held_out: bool = False

    @property
    def level(self) -> int | None:
        """Difficulty that the driver requires for the race; ``None`` for any."""
        return GAME_AI.get(self.driver)


#: The members of the population.
POPULATION = (
    Member("ai:1", "8b779db5539ae7e6"),
    Member("ai:2", "df25f0a35915209c"),
    Member("ai:3", "b2608ce6a4c13123"),
    Member("pursuit", "e7a0dd3e7c727757", is_held_out=True),
    Member("heuristic", "3e63a9f8880fb747"),
    Member("pretrained:rookie", "d6de5c34044c6695"),
    Member("pretrained:regular", "9054fb94c2fa8b23", is_held_out=True),
    Member("pretrained:hunter", "e121cfa1b5d15b11"),
    Member("pretrained:raider", "72c87dc1435e8a09", is_held_out=True),
    Member("pretrained:scout", "12d27e85940cf506", is_held_out=True),
    Member("pretrained:ace", "3dc4f4629e43edf8"),
    Member("pretrained:apex", "14445f7499666f6a", is_held_out=True),
)


def population_digests() -> dict[str, str]:
    """Returns the digest of each driver of the population, by its name."""
    return {member.driver: member.digest for member in POPULATION}


def draw_rivals(races: Iterable[BenchmarkRace]) -> Mapping[int, tuple[str, ...]]:
    """Draws the population's drivers in the races of an evaluation.

    The members take turns, in a random order that depends on the races' seeds only. No driver
    occurs twice in a race, and all members that require a difficulty require the same one.

    Args:
        races: the races.

    Returns:
        Names of drivers for each race with karts of the population, by its number.
    """
    planned = [race for race in races if race.lineup.has_population]
    seeds = ",".join(str(race.seed) for race in planned)
    chance = random.Random(hashlib.sha256(seeds.encode()).hexdigest())
    waiting: list[Member] = []
    return {race.number: draw_members(waiting, race.lineup.rivals, chance) for race in planned}


def draw_members(waiting: list[Member], count: int, chance: random.Random) -> tuple[str, ...]:
    """Draws drivers that can race together: the first ones of a queue.

    Args:
        waiting: the queue. Drivers are removed; if it is too short, all are added in random order.
        count: number of drivers.
        chance: random generator.

    Returns:
        Names of the drivers.
    """
    chosen: list[Member] = []
    while len(chosen) < count:
        levels = {member.level for member in chosen} - {None}
        for member in waiting:
            if member not in chosen and len({*levels, member.level} - {None}) < 2:
                chosen.append(member)
                waiting.remove(member)
                break
        else:
            waiting += chance.sample(POPULATION, len(POPULATION))
    return tuple(member.driver for member in chosen)
