"""The road ahead in its own coordinates: along, across and above."""

import math

import numpy as np
import pytest

from stkzoo.agents.planning.road import LINE_MARKS, MARK_COUNT, MARK_SPACING, headings_of
from tests.oracle.road_ahead import RoadAhead

RADIUS = 60.0


def road_of(x, z, left=6.0, right=6.0):
    line = np.zeros((1, len(LINE_MARKS), 5), np.float32)
    line[0, :, 0], line[0, :, 2], line[0, :, 3], line[0, :, 4] = x, z, left, right
    return RoadAhead.of(line, headings_of(line), MARK_SPACING)


def right_bend():
    way = LINE_MARKS / RADIUS
    return road_of(RADIUS * (1 - np.cos(way)), RADIUS * np.sin(way))


def test_a_bend_to_the_right_has_positive_curvature():
    assert right_bend().curvature[0, 2:20] == pytest.approx(1 / RADIUS, rel=0.05)


def test_places_are_converted_to_road_coordinates():
    turn = 0.5
    spot = [RADIUS - (RADIUS - 3) * math.cos(turn), 1.0, (RADIUS - 3) * math.sin(turn)]
    places = right_bend().place(np.array([[spot]], np.float32))
    assert places.along[0, 0] == pytest.approx(turn * RADIUS, abs=0.5)
    assert places.across[0, 0] == pytest.approx(3.0, abs=0.1)  # on the inner side
    assert places.above[0, 0] == pytest.approx(1.0)


def test_a_place_has_the_distances_to_the_edges_there():
    road = road_of(0.0, LINE_MARKS, left=LINE_MARKS / 10, right=LINE_MARKS / 20)
    places = road.place(np.array([[[2.0, 0.0, 31.0]]], np.float32))
    assert places.left[0, 0] == pytest.approx(3.0)
    assert places.right[0, 0] == pytest.approx(1.5)


def test_the_offset_is_the_karts_place_across_the_road():
    straight = road_of(-2.5, LINE_MARKS)
    assert straight.offset[0] == pytest.approx(2.5)
    assert straight.bends(np.array([30.0]))[0] == pytest.approx(np.zeros(MARK_COUNT))


def test_straightness_is_the_largest_turn_of_the_road():
    assert road_of(0.0, LINE_MARKS).straightness(np.array([30.0]))[0] == 0
    turned = right_bend().straightness(np.array([30.0]))[0]
    assert turned == pytest.approx(30.0 / RADIUS, abs=0.1)
