"""A schedule of races that is as balanced as the numbers allow."""

from __future__ import annotations

import itertools
import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

#: A race or a group of an agent's races, and by node and place the other end of that edge.
Node = tuple[str, int]
Ends = dict[tuple[Node, int], Node]
#: Swaps tried to even out who meets whom, a place in a race; and at most.
_TRIES, _MOST_TRIES = 60, 200_000


@dataclass(frozen=True, slots=True)
class ScheduledRace:
    """One race of a tournament.

    Attributes:
        number: counts the races, from 0.
        track: the track's name.
        seed: of all random choices in the race.
        grid: the agents' numbers, in the order of the grid.
    """

    number: int
    track: str
    seed: int
    grid: tuple[int, ...]


def make_schedule(
    num_agents: int, tracks: Sequence[str], num_races: int, per_race: int, seed: int = 0
) -> tuple[ScheduledRace, ...]:
    """A schedule that favours no agent.

    Of these counts no two differ by more than one: the races of each track; the races of
    each agent, altogether and on each track; the races of one agent from each grid place.
    Exchanging agents between races evens out how often two agents meet. No two races
    have the same seed.

    Args:
        num_agents: number of agents.
        tracks: the tracks, each named once.
        num_races: number of races.
        per_race: agents per race, at most ``num_agents``.
        seed: the same arguments give the same schedule.
    """
    chance = random.Random(seed)
    order = list(tracks)
    chance.shuffle(order)
    counts = [len(range(first, num_races, len(order))) for first in range(len(order))]
    blocks = _deal(num_agents, counts, per_race, chance)
    _even_out_meetings(blocks, chance)
    # One race of each track in turn, so that a part of the tournament is balanced too.
    turns = itertools.zip_longest(*blocks)
    races = [
        (track, agents)
        for turn in turns
        for track, agents in zip(order, turn, strict=True)
        if agents is not None
    ]
    grids = _grids(num_agents, races, chance)
    return tuple(
        ScheduledRace(number, track, seed + number, grid)
        for number, ((track, _), grid) in enumerate(zip(races, grids, strict=True))
    )


def extend_schedule(
    races: Sequence[ScheduledRace], num_agents: int, num_newcomers: int, count: int, seed: int = 0
) -> tuple[ScheduledRace, ...]:
    """More races, in which newcomers meet the agents of the races so far.

    Each race has up to half newcomers. Newcomers have equally often a seat, up to one race, on each
    track; so have the other agents.

    Args:
        races: the races so far; the new ones follow with their numbers and seeds.
        num_agents: number of agents so far.
        num_newcomers: number of new agents, whose numbers follow.
        count: number of new races.
        seed: the same arguments give the same schedule.
    """
    per_race = len(races[0].grid)
    tracks = list(dict.fromkeys(race.track for race in races))
    seats = newcomer_seats(num_newcomers, per_race)
    new = make_schedule(num_newcomers, tracks, count, seats, seed)
    old = make_schedule(num_agents, tracks, count, per_race - seats, seed)
    joint = [
        (one.track, [*(num_agents + agent for agent in one.grid), *two.grid])
        for one, two in zip(new, old, strict=True)
    ]
    grids = _grids(num_agents + num_newcomers, joint, random.Random(seed))
    return tuple(
        ScheduledRace(number, track, races[0].seed + number, grid)
        for number, ((track, _), grid) in enumerate(zip(joint, grids, strict=True), len(races))
    )


def newcomer_seats(num_newcomers: int, per_race: int) -> int:
    """Newcomers in each race of :func:`extend_schedule`."""
    return min(num_newcomers, per_race // 2)


def _deal(
    num_agents: int, counts: Sequence[int], per_race: int, chance: random.Random
) -> list[list[list[int]]]:
    """The agents of each race of each track, dealt in turn like cards.

    Any number of races in a row have each agent equally often, up to one; so do the races
    of a track, and all of them.
    """
    agents = list(range(num_agents))
    chance.shuffle(agents)
    cards = itertools.cycle(agents)
    return [[list(itertools.islice(cards, per_race)) for _ in range(count)] for count in counts]


def _even_out_meetings(blocks: Sequence[list[list[int]]], chance: random.Random) -> None:
    """Exchanges agents between races of one track as long as meetings get more even."""
    meetings: Counter[tuple[int, int]] = Counter()
    for race in itertools.chain.from_iterable(blocks):
        meetings.update(_pair(a, b) for a, b in itertools.combinations(race, 2))
    long_enough = [block for block in blocks if len(block) > 1]
    places = sum(len(race) for block in long_enough for race in block)
    for _ in range(min(places * _TRIES, _MOST_TRIES)):
        block = chance.choice(long_enough)
        first, second = chance.sample(block, 2)
        mine, other = chance.choice(first), chance.choice(second)
        if mine not in second and other not in first:
            _exchange_if_better(first, second, mine, other, meetings)


def _exchange_if_better(
    first: list[int], second: list[int], mine: int, other: int, meetings: Counter[tuple[int, int]]
) -> None:
    mates = [agent for agent in first if agent != mine]
    others = [agent for agent in second if agent != other]
    gone = [_pair(mine, a) for a in mates] + [_pair(other, a) for a in others]
    come = [_pair(other, a) for a in mates] + [_pair(mine, a) for a in others]
    change: Counter[tuple[int, int]] = Counter(come)
    change.subtract(gone)
    # The change of the sum of squares of all counts.
    if sum(delta * (2 * meetings[pair] + delta) for pair, delta in change.items()) <= 0:
        meetings.update(change)
        first[first.index(mine)], second[second.index(other)] = other, mine


def _pair(one: int, two: int) -> tuple[int, int]:
    return (one, two) if one < two else (two, one)


def _grids(
    num_agents: int, races: Sequence[tuple[str, list[int]]], chance: random.Random
) -> list[tuple[int, ...]]:
    """Each race's agents in an order such that all have all places equally often.

    Each agent's races, those of one track together, are cut into groups of as many as
    there are places; within a group no place comes twice. That is the colouring of the edges
    of a graph between races and groups with the places as colours, which König's theorem
    says there is, and which his exchange of two colours along a path finds.
    """
    size = len(races[0][1]) if races else 0
    group_of: dict[tuple[int, int], int] = {}
    for agent in range(num_agents):
        own = sorted(
            (number for number, (_, agents) in enumerate(races) if agent in agents),
            key=lambda number: races[number][0],
        )
        for turn, number in enumerate(own):
            group_of[number, agent] = num_agents * (turn // size) + agent
    edges = list(group_of)
    chance.shuffle(edges)
    ends: Ends = {}
    for edge in edges:
        _colour(("race", edge[0]), ("group", group_of[edge]), ends, size, chance)
    return [
        tuple(ends[("race", number), place][1] % num_agents for place in range(size))
        for number in range(len(races))
    ]


def _colour(race: Node, group: Node, ends: Ends, size: int, chance: random.Random) -> None:
    """Gives one more edge a place that is free at both of its ends."""
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
    """Exchanges two places along the path that leaves a node by ``first``."""
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
