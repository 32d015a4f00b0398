"""Events on snapshots made by hand."""

import copy
from itertools import pairwise

import numpy as np
import pytest

from stkzoo.engine.snapshot import HEADER_DTYPE, ITEM_DTYPE, KART_DTYPE, Snapshot
from stkzoo.engine.track import TrackMap
from stkzoo.errors import ConfigError
from stkzoo.mdp.events import EVENTS, RaceEvents
from stkzoo.mdp.transition import Transition

#: A straight road of 1 km along z.
ROAD = TrackMap(
    1000.0,
    np.array([[[0, 0, 0], [0, 0, 1000]]], np.float32),
    np.full((1, 1), 10, np.float32),
    np.array([[0, 1000]], np.float32),
    [[0]],
)
FAR = [[10.0 * kart, 0.0, 0.0] for kart in range(3)]


def moment(time, **fields):
    """Returns a snapshot of three karts, 10 m apart and at 20 m/s by default."""
    header = np.zeros((), HEADER_DTYPE)
    header["time"] = time
    karts = np.zeros(3, KART_DTYPE)
    karts["rotation"][:, 0] = karts["is_on_road"] = 1
    karts["size"] = 0.8, 0.7, 1.4
    karts["position"], karts["location"] = (1, 2, 3), FAR
    karts["velocity"][:, 2] = karts["speed"] = 20.0
    karts["attachment_type"] = 9
    for name, value in fields.items():
        karts[name] = value
    return Snapshot.of(header, karts, np.zeros(0, ITEM_DTYPE))


def count(*moments, events=None):
    """Returns the counts ``(K,)`` of each event that occurs in the steps."""
    events = RaceEvents(ROAD, 0.1, 3) if events is None else events
    sums = np.zeros_like(events.counts)
    for time, (before, after) in enumerate(pairwise(moments)):
        events.count(moment(time, **before), moment(time + 0.1, **after))
        sums += events.counts
    return {name: row.tolist() for name, row in zip(EVENTS, sums.T, strict=True) if row.any()}


def test_each_pair_that_swaps_ranks_counts_as_an_overtake():
    assert count({}, {"position": (3, 1, 2)}) == {"overtake": [0, 1, 1], "overtaken": [2, 0, 0]}
    assert count({}, {"position": (2, 1, 3)}, {}) == {"overtake": [1, 1, 0], "overtaken": [1, 1, 0]}


def test_karts_that_have_finished_neither_overtake_nor_are_overtaken():
    assert count({"has_finished_race": (1, 0, 0)}, {"position": (3, 1, 2)}) == {}


def test_nothing_counts_before_go():
    events = RaceEvents(ROAD, 0.1, 3)
    events.count(moment(0.0), moment(0.0, position=(3, 1, 2), is_on_road=0))
    assert not events.counts.any()
    assert not events.seconds.any()


def test_a_long_touch_is_one_contact_and_a_later_touch_is_another():
    together = {"location": [[0, 0, 0], [0.5, 0, 0], [20, 0, 0]]}
    assert count({}, *[together] * 9) == {"kart_contact": [1, 1, 0]}
    assert count({}, together, {}, together) == {"kart_contact": [1, 1, 0]}
    assert count({}, together, *[{}] * 8, together) == {"kart_contact": [2, 2, 0]}
    above = {"location": [[0, 0, 0], [0, 2, 0], [20, 0, 0]]}
    assert count({}, above) == {}


def test_karts_that_collide_between_two_snapshots_touch():
    before = {"location": [[0, 0, 0], [0, 0, 3.4], [20, 0, 0]]}
    closing = {"velocity": [[0, 0, 20], [0, 0, -20], [0, 0, 0]]}
    parting = {"velocity": [[0, 0, -20], [0, 0, 20], [0, 0, 0]]}
    counted = count({**before, **closing}, {**before, **parting})
    assert counted["kart_contact"] == [1, 1, 0]
    assert "wall_contact" not in counted


@pytest.mark.parametrize(
    ("velocity", "others", "is_contact"),
    [
        ((0, 0, 10), {}, True),
        ((0, 0, -5), {}, True),
        ((0, 0, 16), {}, False),  # braking
        ((0, 15, 12), {}, False),  # landing
        ((0, 0, 14), {"attachment_type": 0}, False),  # dragging a parachute
        ((0, 0, 10), {"attachment_type": 0}, True),
    ],
)
def test_a_loss_of_speed_is_a_wall_contact_only_without_another_cause(velocity, others, is_contact):
    after = np.array([[0, 0, 20]] * 3)
    after[1] = velocity
    counted = count(others, {"velocity": after} | others)
    assert counted.get("wall_contact") == ([0, 1, 0] if is_contact else None)


def test_a_rescue_counts_only_as_a_rescue():
    carried = {"speed": (0, 20, 20), "velocity": [[0, 0, -9], [0, 0, 20], [0, 0, 20]]}
    places = [(0, 0), (1, 0), (2, 0), (5, 40), (4, 40), (3, 40)]  # up, elsewhere, down
    ride = [{**carried, "location": [[0, y, z], *FAR[1:]]} for y, z in places]
    set_down = {"velocity": [[0, 0, 0], [0, 0, 20], [0, 0, 20]], "location": ride[-1]["location"]}
    assert count(*ride, set_down) == {"rescue": [1, 0, 0]}


def test_items_that_are_taken_used_or_hit_are_counted():
    empty, one = {"powerup_type": 0}, {"powerup_type": (3, 0, 0), "powerup_num": (1, 0, 0)}
    other = {"powerup_type": (2, 0, 0), "powerup_num": (1, 0, 0)}
    assert count(empty, one, other, empty) == {"item_taken": [2, 0, 0], "item_used": [1, 0, 0]}
    assert count({}, {"energy": (0, 1, 0)}, {}) == {"item_taken": [0, 1, 0]}
    shield, anvil = {"attachment_type": 6}, {"attachment_type": (6, 6, 1)}
    assert count({}, shield, anvil, {}) == {"hit": [0, 0, 1]}


def test_time_off_the_road_and_in_the_wrong_direction_is_counted():
    lost = {"is_on_road": (0, 1, 1), "velocity": [[0, 0, 20], [9, 0, -2], [9, 0, -0.5]]}
    counted = count(lost, lost, lost)
    assert counted["off_road"] == pytest.approx([0.2, 0, 0])
    assert counted["wrong_way"] == pytest.approx([0, 0.2, 0])


def test_a_copy_counts_independently():
    together = {"location": [[0, 0, 0], [0.5, 0, 0], [20, 0, 0]]}
    first = RaceEvents(ROAD, 0.1, 3)
    count({}, together, events=first)
    twin = copy.deepcopy(first)
    assert count(*[{}] * 8, together, events=first) == {"kart_contact": [1, 1, 0]}
    assert count({}, together, events=twin) == {}


def test_a_reward_term_reads_events_by_name():
    counts = np.arange(20.0).reshape(2, 10)
    step = Transition(moment(0), moment(1), 100.0, counts)
    assert step.event("hit").tolist() == [2, 12]
    with pytest.raises(ConfigError, match=r"'hits'.*hit"):
        step.event("hits")
    with pytest.raises(ConfigError, match="events=True"):
        Transition(moment(0), moment(1), 100.0).event("hit")
