"""Events counted in steps of 0.1 s, compared with trajectories at 120 Hz in two short races."""

from itertools import pairwise

import numpy as np
import pytest

from benchmarks.events import SCRIPTS, compare
from benchmarks.events_races import TICKS, record
from stkzoo.mdp.events import EVENTS, RaceEvents
from tests.oracle.event_counter import EventCounter


@pytest.fixture(scope="module")
def race():
    return record("olivermath", 104, SCRIPTS, bots=3, seconds=30.0)


@pytest.mark.slow
def test_event_counts_match_the_trajectories(race):
    found = compare(race)
    assert found["rammer"]["kart_contact"][0] > 2
    assert found["cutter"]["off_road"][0] > 4.0
    assert found["ghost"]["wrong_way"][0] > 3.0
    for name in EVENTS:
        counted, true = np.sum([own[name] for own in found.values()], axis=0)
        assert counted == pytest.approx(true, abs=1.0, rel=0.1), name


@pytest.mark.slow
def test_the_counter_matches_its_reference_implementation(race):
    ours = RaceEvents(race.track, 0.1, 6)
    memory, counts = ours._memory.copy(), np.zeros_like(ours.counts)
    twin = EventCounter(race.track.path_nodes, 0.1, memory, counts)
    total = np.zeros(len(EVENTS))
    steps = race.moments[::TICKS]
    for before, after in pairwise(steps):
        ours.count(before, after)
        twin.count(before.data, after.data)
        assert np.array_equal(ours.counts, counts)
        total += counts.sum(0)
    assert np.allclose(ours._memory, memory)
    assert (total[[0, 1, 3, 5, 6, 8, 9]] > 0).all()


@pytest.mark.slow
def test_a_clean_solo_race_counts_only_items_and_time_off_road():
    found = compare(record("lighthouse", 103, ("expert",), seconds=30.0))["expert"]
    nothing = (
        "kart_contact",
        "wall_contact",
        "hit",
        "overtake",
        "overtaken",
        "rescue",
        "wrong_way",
    )
    assert {name: found[name] for name in nothing} == {name: [0.0, 0.0] for name in nothing}
    assert found["item_taken"][0] == found["item_taken"][1] > 0
    assert found["off_road"][0] == pytest.approx(found["off_road"][1], abs=1.0)
