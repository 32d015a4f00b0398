"""Inputs of plans and policies in the extension, compared with the oracle."""

import numpy as np
import pytest

from stkzoo import ItemType, PowerupType
from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.driver import _LOGITS, INPUT_SIZE
from stkzoo.agents.planning.memory import PlanMemory
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.road import MARK_COUNT, MARK_SPACING, headings_of
from stkzoo.agents.planning.worth import OwnState, plan_rules
from stkzoo.wrappers.racing import SIZE
from tests.oracle import plan_viewer

RULES = plan_rules(DriverParameters())
ITEMS, RIVALS = 8, 4
NAMES = ("rows", "karts", "road", "items", "rivals", "scene")


def winding_road(chance, count):
    """Returns winding roads; some turn by more than half a circle."""
    bends = chance.uniform(-0.03, 0.03, (count, 1)) * chance.choice([1, 2, 6], (count, 1))
    angles = chance.uniform(-0.5, 0.5, (count, 1)) + bends * MARK_SPACING * np.arange(
        MARK_COUNT + 1
    )
    steps = MARK_SPACING * np.stack([np.sin(angles), 0.05 * angles, np.cos(angles)], axis=-1)
    line = np.empty((count, MARK_COUNT + 1, 5), np.float32)
    line[..., :3] = np.cumsum(steps, axis=1) + chance.uniform(-3, 3, (count, 1, 3))
    line[..., 3:] = chance.uniform(0, 9, (count, MARK_COUNT + 1, 2))  # to the left, to the right
    return line


def own_of(chance, count):
    return OwnState(
        velocity=chance.normal([0, 0, 15], [2, 1, 10], (count, 3)).astype(np.float32),
        energy=chance.choice([0.0, 3.0], (count, 1)).astype(np.float32),
        jumping=chance.integers(0, 2, count),
        powerup_type=chance.choice(list(PowerupType), count).astype(np.int64),
        powerup_count=chance.integers(0, 3, count),
    )


def memory_of(chance, count):
    memory = chance.integers(0, 6, (len(PlanMemory._fields), count)).astype(np.float32)
    names = PlanMemory._fields
    memory[names.index("drift_side")] = chance.integers(-1, 2, count)
    memory[names.index("drift_steps")] = chance.integers(0, 60, count)
    memory[names.index("release_steps")] = chance.integers(0, 8, count)
    return memory


def scene_arguments(seed, count=60, num_karts=6, num_items=14, rivals=RIVALS):
    """Returns arguments for karts that saw some of their rivals in the previous step."""
    chance = np.random.default_rng(seed)
    line, own = winding_road(chance, count), own_of(chance, count)
    karts, items = (
        chance.normal([0, 0, 8], [5, 1.5, 12], (count, number, 3)).astype(np.float32)
        for number in (num_karts, num_items)
    )
    karts[chance.random((count, num_karts)) < 0.2] = np.inf
    types = chance.choice([*ItemType, -1, 99], (count, num_items)).astype(np.int64)
    seen = (line, headings_of(line), chance.uniform(0.02, 0.4, (count, 1)).astype(np.float32))
    spots = np.full((count, RIVALS, 2), 1e3, np.float32)
    spots[:, : min(num_karts, 3)] = np.where(np.isfinite(karts), karts, 1e3)[:, :3, ::2]
    spots += chance.normal(size=spots.shape).astype(np.float32)
    before = spots, own.velocity[:, ::2].copy(), headings_of(winding_road(chance, count))
    now = np.empty_like(spots), np.empty((count, 2), np.float32)
    out = (
        np.empty(count, np.intp),
        np.empty((count, 16), np.float32),
        np.empty((count, 4, MARK_COUNT), np.float32),
        np.empty((count, ITEMS, 4)),
        np.empty((count, rivals, 5)),
        np.empty((count, 5), np.float32),
    )
    memory = memory_of(chance, count)
    around = (*seen, karts, items, types)
    return RULES.view, RULES.worths, memory, own, around, before, now, out


def surveyed(survey, arguments):
    """Returns the arrays that a survey writes, by name."""
    *given, around, before, now, out = arguments
    line, headings, *rest = around
    headings, now, out = headings.copy(), [a.copy() for a in now], [a.copy() for a in out]
    survey(*given, (line, headings, *rest), before, tuple(now), tuple(out))
    written = dict(zip(NAMES, out, strict=True))
    return written | {"headings": headings, "spots": now[0], "velocity": now[1]}


@pytest.mark.parametrize(
    "sizes",
    [{}, {"num_karts": 0}, {"num_karts": 2}, {"num_items": 0}, {"num_items": 3}],
    ids=str,
)
@pytest.mark.parametrize("seed", range(8))
def test_survey_road_matches_the_oracle(seed, sizes):
    arguments = scene_arguments(seed, **sizes)
    ours = surveyed(_planning.survey_road, arguments)
    theirs = surveyed(plan_viewer.survey_road, arguments)
    for name, array in theirs.items():
        np.testing.assert_allclose(ours[name], array, rtol=2e-6, atol=2e-5, err_msg=name)
    assert (np.abs(np.diff(theirs["headings"], axis=1)) < np.pi).all()


@pytest.mark.parametrize("survey", [_planning.survey_road, plan_viewer.survey_road])
def test_each_side_of_the_road_has_its_own_edge(survey):
    *given, around, before, now, out = scene_arguments(0, count=3, num_items=2)
    line, headings, _, _, items, types = around
    line[:], headings[:], types[:] = 0, 0, ItemType.BANANA
    line[..., 2], line[..., 3:] = MARK_SPACING * np.arange(MARK_COUNT + 1), (2.0, 5.0)
    line[..., 0] = [[-4.0], [0.0], [3.0]]  # karts to the right of the line, on it, to the left
    items[:] = line[:, 5:6, :3] + np.array([[-4.0, 0, 0], [4.0, 0, 0]], np.float32)
    given[2][PlanMemory._fields.index("caution_steps")] = 0
    found = surveyed(survey, (*given, around, before, now, out))
    np.testing.assert_allclose(found["scene"][:, 2], [4.0 - 5.0, -2.0, 3.0 - 2.0], atol=1e-5)
    margin = RULES.parameters.margin
    np.testing.assert_allclose(found["road"][:, 1], 2.0 - margin, rtol=1e-6)
    np.testing.assert_allclose(found["road"][:, 2], 5.0 - margin, rtol=1e-6)
    is_kept = found["items"][..., 2] != 0
    np.testing.assert_allclose(found["items"][is_kept, 1], 3 * [4.0], atol=1e-5)


def test_rivals_can_be_left_out():
    arguments = scene_arguments(0, rivals=0)
    ours = surveyed(_planning.survey_road, arguments)
    theirs = surveyed(plan_viewer.survey_road, arguments)
    np.testing.assert_allclose(ours["karts"], theirs["karts"], rtol=2e-6, atol=2e-5)
    assert ours["rivals"].size == 0


def present_arguments(seed, count=60, width=INPUT_SIZE):
    """Returns arguments with random values of plans."""
    chance = np.random.default_rng(seed)
    best = chance.normal([[[30]], [[0]], [[1]]], [[[20]], [[0.5]], [[1]]], (3, count, 4))
    best[0, chance.random((count, 4)) < 0.3] = -1e4
    scene = chance.normal(0, [0.3, 3, 4, 0.2, 1], (count, 5))
    scene[:, 4] = chance.integers(0, 2, count)
    rivals = chance.normal(0, 9, (count, RIVALS, 5)).astype(np.float32).astype(float)
    rivals[..., 0] = chance.integers(0, 2, (count, RIVALS))
    return (
        RULES.view,
        _LOGITS,
        memory_of(chance, count),
        own_of(chance, count),
        best.astype(np.float32),
        scene.astype(np.float32),
        rivals,
        np.zeros((count, 15), np.float32),
        np.zeros((count, width), np.float32),
        SIZE,
    )


@pytest.mark.parametrize("seed", range(8))
def test_present_plans_matches_the_oracle(seed):
    *given, prior, inputs, first = present_arguments(seed)
    ours, theirs = (prior.copy(), inputs.copy()), (prior, inputs)
    _planning.present_plans(*given, *ours, first)
    plan_viewer.present_plans(*given, *theirs, first)
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-6, atol=1e-6)
    assert inputs[:, SIZE:].any()
    assert len(np.unique(prior[:, -4:], axis=0)) > 1


def test_plans_of_unknown_worth_have_an_unknown_prior():
    *given, prior, inputs, first = present_arguments(0)
    given[4][:, 3] = np.nan
    ours, theirs = (prior.copy(), inputs.copy()), (prior, inputs)
    _planning.present_plans(*given, *ours, first)
    plan_viewer.present_plans(*given, *theirs, first)
    assert np.isnan(prior[3, :4]).all()
    for own, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(np.isnan(own), np.isnan(other))


def test_the_prior_needs_no_inputs():
    *given, prior, _, first = present_arguments(0)
    alone = prior.copy()
    _planning.present_plans(*given, alone, np.zeros((len(prior), 0), np.float32), first)
    *given, prior, inputs, first = present_arguments(0)
    _planning.present_plans(*given, prior, inputs, first)
    assert (alone == prior).all()
