"""Balanced schedules of races."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

#: A node of the graph in :func:`_grids`: a race, or a group of races of one agent.
Node = tuple[str, int]
#: The other end of each colored edge, by node and place.
Ends = dict[tuple[Node, int], Node]
#: Number of attempted swaps to balance meetings of agents, per seat in a race; and the maximum.
_TRIES, _MOST_TRIES = 60, 200_000


@dataclass(frozen=True, slots=True)
class ScheduledRace:
    """One race of a tournament.

    Attributes:
        number: number of the race, from 0.
        track: name of the track.
        seed: seed of all random choices in the race.
        grid: numbers of the agents in grid order.
    """

    number: int
    track: str
    seed: int
    grid: tuple[int, ...]


def make_schedule(
    num_agents: int, tracks: Sequence[str], num_races: int, per_race: int, seed: int = 0
) -> tuple[ScheduledRace, ...]:
    """Returns a schedule that favors no agent.

    The following counts differ by at most one: the number of races on each track; the number of
    races of each agent, in total and on each track; and the number of races of an agent from each
    grid place. Agents are swapped between races, so that pairs of agents meet about equally often.
    Every race has a different seed.

    Args:
        num_agents: number of agents.
        tracks: the tracks, each named once.
        num_races: number of races.
        per_race: number of agents per race, at most ``num_agents``.
        seed: seed of the schedule. The same arguments return the same schedule.
    """
    chance = random.Random(seed)
    order, counts = _share(tracks, num_races, chance)
    blocks = _deal(num_agents, counts, per_race, chance)
    _even_out_meetings(blocks, chance)
    return _in_turns(num_agents, order, blocks, chance, 0, seed)


def extend_schedule(
    races: Sequence[ScheduledRace], num_agents: int, num_newcomers: int, count: int, seed: int = 0
) -> tuple[ScheduledRace, ...]:
    """Returns additional races, in which newcomers meet the existing agents.

    At most half of the agents in a race are newcomers. On each track, the numbers of races of
    newcomers differ by at most one; the same holds for the existing agents. Agents are swapped
    between races, so that each newcomer meets all others about equally often.

    Args:
        races: the existing races. Numbers and seeds of the new races continue them.
        num_agents: number of existing agents.
        num_newcomers: number of new agents. Their numbers follow those of the existing agents.
        count: number of new races.
        seed: seed of the schedule. The same arguments return the same schedule.
    """
    per_race, seats = len(races[0].grid), newcomer_seats(num_newcomers, len(races[0].grid))
    chance = random.Random(seed)
    order, counts = _share(dict.fromkeys(race.track for race in races), count, chance)
    new = _deal(num_newcomers, counts, seats, chance, num_agents)
    old = _deal(num_agents, counts, per_race - seats, chance)
    blocks = [
        [[*one, *two] for one, two in zip(*block, strict=True)]
        for block in zip(new, old, strict=True)
    ]
    _even_out_meetings(blocks, chance, num_agents)
    total = num_agents + num_newcomers
    return _in_turns(total, order, blocks, chance, len(races), races[0].seed)


def newcomer_seats(num_newcomers: int, per_race: int) -> int:
    """Returns the number of newcomers in each race of :func:`extend_schedule`."""
    return min(num_newcomers, per_race // 2)


def _share(
    tracks: Iterable[str], num_races: int, chance: random.Random
) -> tuple[list[str], list[int]]:
    """Returns the tracks in random order, and the number of races on each."""
    order = list(tracks)
    chance.shuffle(order)
    return order, [len(range(first, num_races, len(order))) for first in range(len(order))]


def _deal(
    num_agents: int,
    counts: Sequence[int],
    per_race: int,
    chance: random.Random,
    first: int = 0,
) -> list[list[list[int]]]:
    """Returns the agents of each race of each track, dealt in turn like cards.

    The numbers of the agents start at ``first``.

    In any sequence of consecutive races, the numbers of races of the agents differ by at most one.
    This includes the races of one track, and all races.
    """
    agents = list(range(first, first + num_agents))
    chance.shuffle(agents)
    cards = itertools.cycle(agents)
    return [[list(itertools.islice(cards, per_race)) for _ in range(count)] for count in counts]


def _even_out_meetings(
    blocks: Sequence[list[list[int]]], chance: random.Random, num_existing: int = 0
) -> None:
    """Swaps agents between races of one track where this balances meetings of agents.

    The first ``num_existing`` agents take the seats of each other only, and so do the others.
    """
    meetings: Counter[tuple[int, int]] = Counter()
    for race in itertools.chain.from_iterable(blocks):
        meetings.update(_pair(a, b) for a, b in itertools.combinations(race, 2))
    long_enough = [block for block in blocks if len(block) > 1]
    places = sum(len(race) for block in long_enough for race in block)
    for _ in range(min(places * _TRIES, _MOST_TRIES)):
        block = chance.choice(long_enough)
        first, second = chance.sample(block, 2)
        one, other = chance.choice(first), chance.choice(second)
        is_same_kind = (one < num_existing) == (other < num_existing)
        if is_same_kind and one not in second and other not in first:
            _exchange_if_better(first, second, one, other, meetings)


def _exchange_if_better(
    first: list[int], second: list[int], one: int, other: int, meetings: Counter[tuple[int, int]]
) -> None:
    mates = [agent for agent in first if agent != one]
    others = [agent for agent in second if agent != other]
    gone = [_pair(one, a) for a in mates] + [_pair(other, a) for a in others]
    come = [_pair(other, a) for a in mates] + [_pair(one, a) for a in others]
    change: Counter[tuple[int, int]] = Counter(come)
    change.subtract(gone)
    # The swap must not increase the sum of squares of all counts.
    if sum(delta * (2 * meetings[pair] + delta) for pair, delta in change.items()) <= 0:
        meetings.update(change)
        first[first.index(one)], second[second.index(other)] = other, one


def _pair(one: int, two: int) -> tuple[int, int]:
    return (one, two) if one < two else (two, one)


def _in_turns(
    num_agents: int,
    order: Sequence[str],
    blocks: Sequence[list[list[int]]],
    chance: random.Random,
    first: int,
    seed: int,
) -> tuple[ScheduledRace, ...]:
    """Returns the races of all tracks, numbered from ``first``.

    Tracks alternate, so that an unfinished tournament is also balanced.
    """
    races = [
        (track, agents)
        for turn in itertools.zip_longest(*blocks)
        for track, agents in zip(order, turn, strict=True)
        if agents is not None
    ]
    grids = _grids(num_agents, races, chance)
    return tuple(
        ScheduledRace(number, track, seed + number, grid)
        for number, ((track, _), grid) in enumerate(zip(races, grids, strict=True), first)
    )


def _grids(
    num_agents: int, races: Sequence[tuple[str, list[int]]], chance: random.Random
) -> list[tuple[int, ...]]:
    """Returns the agents of each race in grid order, with each agent equally often at each place.

    The races of each agent, sorted by track, are split into groups with as many races as there are
    places. Within a group, each place occurs at most once. This is an edge coloring of the
    bipartite graph of races and groups, with places as colors. König's theorem says that it
    exists; exchanging two colors along an alternating path finds it.
    """
    size = len(races[0][1]) if races else 0
    group_of: dict[tuple[int, int], int] = {}
    for agent in range(num_agents):
        numbers = sorted(
            (number for number, (_, agents) in enumerate(races) if agent in agents),
            key=lambda number: races[number][0],
        )
        for turn, number in enumerate(numbers):
            group_of[number, agent] = num_agents * (turn // size) + agent
    edges = list(group_of)
    chance.shuffle(edges)
    ends: Ends = {}
    for edge in edges:
        _color(("race", edge[0]), ("group", group_of[edge]), ends, size, chance)
    return [
        tuple(ends[("race", number), place][1] % num_agents for place in range(size))
        for number in range(len(races))
    ]


def _color(race: Node, group: Node, ends: Ends, size: int, chance: random.Random) -> None:
    """Assigns to another edge a place that is free at both ends, after an exchange if needed."""
    free_here = [place for place in range(size) if (race, place) not in ends]
    free_there = [place for place in range(size) if (group, place) not in ends]
    both = [place for place in free_here if place in free_there]
    if not both:
        here, there = chance.choice(free_here), chance.choice(free_there)
        _exchange_places(group, here, there, ends)
        both = [here]
    place = chance.choice(both)
    ends[race, place], ends[group, place] = group, race


def _exchange_places(start: Node, first: int, second: int, ends: Ends) -> None:
    """Exchanges two places along the alternating path that leaves a node by ``first``."""
    path, node, places = [], start, itertools.cycle((first, second))
    while (node, place := next(places)) in ends:
        other = ends[node, place]
        path.append((node, place, other))
        node = other
    for one, place, two in path:
        del ends[one, place], ends[two, place]
    for one, place, two in path:
        swapped = second if place == first else first
        ends[one, swapped], ends[two, swapped] = two, one
