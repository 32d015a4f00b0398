"""The map shows a race from above."""

from dataclasses import replace

import numpy as np
import pytest

from stkzoo.render.map import MapView
from stkzoo.render.palette import race_palette, readable_on, rgb
from stkzoo.render.scene import clock, ordinal, standings
from tests.support.rendering import drive, small_race


@pytest.fixture(scope="module")
def race():
    """Returns the scene and the snapshots of a short race."""
    with small_race() as env:
        snapshots = [now.snapshot for now in drive(env, 70)]
        return env.scene, snapshots


def count(picture, color, near=30):
    """Returns the number of pixels with approximately the given color."""
    away = np.abs(picture.astype(int) - np.array(rgb(color))).max(axis=2)
    return int((away < near).sum())


@pytest.mark.slow
@pytest.mark.parametrize("size", [(640, 480), (84, 84), (333, 127), (1280, 720), (200, 600)])
def test_a_picture_has_the_requested_size(race, size):
    scene, snapshots = race
    picture = MapView(scene, size).draw(snapshots[-1])
    assert (picture.shape, picture.dtype) == ((size[1], size[0], 3), np.uint8)


def test_every_kart_is_drawn_in_its_color(race):
    scene, snapshots = race
    moved = replace_places(snapshots[-1], scene)
    picture = MapView(scene, (640, 480), panel=False).draw(moved)
    assert all(count(picture, color) > 40 for color in scene.colors)


def replace_places(snapshot, scene):
    """Returns a snapshot with the karts spread over the track, so that none hides another."""
    karts = snapshot.karts.copy()
    nodes = scene.track_map.path_nodes[:, 0]
    for kart in range(len(karts)):
        shift = nodes[kart * len(nodes) // len(karts)] - karts[kart]["location"]
        karts[kart]["location"] += shift
        karts[kart]["front"] += shift
    return type(snapshot).of(snapshot.header, karts, snapshot.items)


def test_a_kart_is_drawn_where_it_is(race):
    scene, snapshots = race
    view = MapView(scene, (400, 400), follow=1, panel=False)
    picture = view.draw(snapshots[-1])
    middle = picture[190:210, 190:210]
    assert count(middle, scene.colors[1]) > 60


def test_the_map_is_not_mirrored(race):
    scene, snapshots = race
    view = MapView(scene, (400, 400), follow=0, panel=False)
    moved = replace_places(snapshots[-1], scene)
    karts = moved.karts.copy()
    karts["location"][1] = karts["location"][0] + [20, 0, 0]  # east
    karts["location"][2] = karts["location"][0] + [0, 0, 20]  # north
    picture = view.draw(type(moved).of(moved.header, karts, moved.items))
    assert count(picture[180:220, 260:320], scene.colors[1]) > 60
    assert count(picture[80:140, 180:220], scene.colors[2]) > 60


def test_karts_leave_trails(race):
    scene, snapshots = race
    without, with_trail = MapView(scene), MapView(scene)
    for snapshot in snapshots:
        with_trail.remember(snapshot)
    assert (without.draw(snapshots[-1]) != with_trail.draw(snapshots[-1])).any()


def test_the_standings_have_the_games_order(race):
    scene, snapshots = race
    lines = standings(scene, snapshots[-1])
    assert [line.rank for line in lines] == [1, 2, 3]
    positions = snapshots[-1].karts["position"]
    assert [positions[line.kart] for line in lines] == [1, 2, 3]


def test_colors_are_distinct_and_stable():
    for number in (1, 8, 40):
        colors = race_palette(number)
        assert len(set(colors)) == number
        assert colors == race_palette(64)[:number]
    assert readable_on("#f0e442") != readable_on("#0072b2")


def test_agents_have_the_first_colors_in_their_own_order(race):
    scene, _ = race
    other = replace(scene, kart_indices=(2, 0))
    assert [other.colors[kart] for kart in (2, 0, 1)] == list(race_palette(3))


def test_a_clock_has_minutes_seconds_and_tenths():
    assert [*map(clock, (-1.0, 0.04, 59.96, 125.32))] == ["0:00.0", "0:00.0", "1:00.0", "2:05.3"]


def test_ranks_differ_from_the_numbers_of_agents_on_the_map():
    assert [*map(ordinal, (1, 2, 3, 4, 11, 21))] == ["1st", "2nd", "3rd", "4th", "11th", "21st"]
