"""The schedule of a tournament is fair."""

from collections import Counter
from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stkzoo.evaluation.tournament.schedule import (
    extend_schedule,
    make_schedule,
    newcomer_seats,
)


def spread(counts, keys):
    """Returns the largest difference between the counts of the keys."""
    values = [counts[key] for key in keys]
    return max(values) - min(values)


@st.composite
def shapes(draw):
    agents = draw(st.integers(2, 12))
    tracks = [f"track_{number}" for number in range(draw(st.integers(1, 6)))]
    return agents, tracks, draw(st.integers(1, 60)), draw(st.integers(2, min(agents, 8)))


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(shapes(), st.integers(0, 1000))
def test_the_schedule_is_balanced(shape, seed):
    num_agents, tracks, num_races, per_race = shape
    races = make_schedule(*shape, seed)
    agents, places = range(num_agents), range(per_race)
    assert [race.number for race in races] == list(range(num_races))
    assert all(len(set(race.grid)) == per_race for race in races)
    assert spread(Counter(race.track for race in races), tracks) <= 1
    assert spread(Counter(agent for race in races for agent in race.grid), agents) <= 1
    on_track = Counter((agent, race.track) for race in races for agent in race.grid)
    for track in tracks:
        assert spread(on_track, [(agent, track) for agent in agents]) <= 1
    at_place = Counter((agent, place) for race in races for place, agent in enumerate(race.grid))
    for agent in agents:
        assert spread(at_place, [(agent, place) for place in places]) <= 1


@pytest.mark.parametrize(("num_agents", "per_race"), [(6, 4), (6, 2), (5, 3), (4, 4)])
def test_all_pairs_of_agents_meet_equally_often(num_agents, per_race):
    races = make_schedule(num_agents, ["a", "b", "c"], 60, per_race, 1)
    met = Counter(frozenset(pair) for race in races for pair in combinations(race.grid, 2))
    pairs = [frozenset(pair) for pair in combinations(range(num_agents), 2)]
    assert spread(met, pairs) <= 1


def test_each_part_of_a_tournament_has_all_tracks():
    races = make_schedule(4, ["a", "b", "c"], 30, 3, 1)
    for first in range(0, 30, 3):
        assert {race.track for race in races[first : first + 3]} == {"a", "b", "c"}


def test_the_same_seed_gives_the_same_schedule():
    assert make_schedule(6, ["a", "b"], 20, 4, 1) == make_schedule(6, ["a", "b"], 20, 4, 1)
    assert make_schedule(6, ["a", "b"], 20, 4, 1) != make_schedule(6, ["a", "b"], 20, 4, 2)


#: Numbers of existing agents and of newcomers, and the number of agents per race.
EXTENSIONS = [(2, 2, 2), (4, 2, 2), (4, 4, 4), (5, 5, 4), (6, 3, 4), (8, 4, 4), (3, 7, 3)]


@pytest.mark.parametrize(("existing", "newcomers", "per_race"), EXTENSIONS)
@pytest.mark.parametrize("tracks", [["a"], ["a", "b", "c"]])
def test_newcomers_meet_all_existing_agents_equally_often(existing, newcomers, per_race, tracks):
    races = make_schedule(existing, tracks, 20, per_race, 1)
    more = extend_schedule(races, existing, newcomers, 60, 1)
    met = Counter(frozenset(pair) for race in more for pair in combinations(race.grid, 2))
    old, new = range(existing), range(existing, existing + newcomers)
    assert spread(met, [frozenset((one, two)) for one in old for two in new]) <= 1
    assert spread(met, [frozenset(pair) for pair in combinations(new, 2)] or [()]) <= 1


@pytest.mark.parametrize(("existing", "newcomers", "per_race"), EXTENSIONS)
def test_additional_races_are_balanced(existing, newcomers, per_race):
    tracks = ["a", "b", "c"]
    races = make_schedule(existing, tracks, 20, per_race, 1)
    more = extend_schedule(races, existing, newcomers, 40, 1)
    assert [race.seed for race in more] == list(range(21, 61))
    assert spread(Counter(race.track for race in more), tracks) <= 1
    seats = newcomer_seats(newcomers, per_race)
    assert {sum(agent >= existing for agent in race.grid) for race in more} == {seats}
    on_track = Counter((agent, race.track) for race in more for agent in race.grid)
    at_place = Counter((agent, place) for race in more for place, agent in enumerate(race.grid))
    for kind in (range(existing), range(existing, existing + newcomers)):
        for track in tracks:
            assert spread(on_track, [(agent, track) for agent in kind]) <= 1
        for agent in kind:
            assert spread(at_place, [(agent, place) for place in range(per_race)]) <= 1
