"""Races against the rammer differ, and rates count the contacts of the chosen drivers."""

from benchmarks.conduct import rate
from benchmarks.conduct_races import GROUPS, RAMMER, orders
from stkzoo.suite import JudgedContact, KartConduct, RaceConduct
from stkzoo.tracks import TRAIN_TRACKS


def test_no_two_races_have_the_same_track_direction_and_grid():
    planned = orders("rammer", 120)
    settings = [(order.settings.track, order.settings.reverse) for order in planned]
    assert set(settings) == {(track, way) for track in TRAIN_TRACKS for way in (False, True)}
    assert len({(*own, order.drivers) for own, order in zip(settings, planned, strict=True)}) == 120
    assert all(sorted(order.drivers) == sorted(GROUPS["rammer"]) for order in planned)


def test_a_rate_is_the_share_of_contacts_at_fault():
    karts = [KartConduct(name, name, 3, 0, 0.0, 0) for name in (RAMMER, "ace", "ai")]
    contacts = [
        JudgedContact(10, (0, 1), (1, 1), (0.5, None), (2.0, 1.0)),
        JudgedContact(40, (0, 1), (1, 1), (None, None), (1.0, 1.0)),
        JudgedContact(70, (1, 2), (1, 1), (0.3, None), (1.0, 1.0)),
    ]
    race = RaceConduct("", "mines", False, 100, tuple(karts), tuple(contacts))
    found = rate([race], lambda own, other, _: own == RAMMER and other == "ace")
    assert (found["contacts"], found["at_fault"], found["rate"]["value"]) == (2, 1, 0.5)
    assert found["median_start"] == 0.5
    found = rate([race], lambda own, *_: own == "ace")
    assert (found["contacts"], found["at_fault"]) == (3, 1)
    found = rate([race], lambda own, _, lead: own == RAMMER and lead > 0)
    assert (found["contacts"], found["at_fault"]) == (1, 1)
    found = rate([race], lambda own, _, lead: own == "ace" and lead < 0)
    assert (found["contacts"], found["at_fault"]) == (1, 0)
