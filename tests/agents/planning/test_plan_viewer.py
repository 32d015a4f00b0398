"""Plans and policies' inputs from the extension, compared with the oracle."""

import numpy as np
import pytest

from stkzoo import ItemType, PowerupType
from stkzoo.agents.planning import _planning
from stkzoo.agents.planning.driver import INPUT_SIZE
from stkzoo.agents.planning.memory import MARK_COUNT, MARK_SPACING, DriverMemory, PlanMemory
from stkzoo.agents.planning.motion import learned_motion
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.worth import plan_parts
from stkzoo.wrappers.racing import OWN_PLACES, OWN_SIZE, SIZE, Surroundings
from tests.oracle import plan_viewer

RULES = DriverParameters()


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
    own = np.zeros((count, OWN_SIZE), np.float32)
    for key, column in {
        "velocity": chance.normal([0, 0, 15], [2, 1, 10], (count, 3)),
        "max_steer_angle": chance.uniform(0.02, 0.4, (count, 1)),
        "energy": chance.choice([0.0, 3.0], (count, 1)),
        "jumping": chance.integers(0, 2, (count, 1)),
        "powerup_type": chance.choice(list(PowerupType), (count, 1)),
        "powerup_count": chance.integers(0, 3, (count, 1)),
    }.items():
        own[:, OWN_PLACES[key]] = column
    return own


def memory_of(chance, count):
    memory = chance.integers(0, 6, (len(PlanMemory._fields), count)).astype(np.float32)
    names = PlanMemory._fields
    memory[names.index("turn")] = chance.uniform(-1, 1, count)
    memory[names.index("drift_side")] = chance.integers(-1, 2, count)
    memory[names.index("drift_steps")] = chance.integers(0, 60, count)
    memory[names.index("release_steps")] = chance.integers(0, 8, count)
    memory[names.index("hop_steps")] = chance.integers(0, 2, count)
    return memory


def scene_arguments(
    seed, count=60, num_karts=6, num_items=14, *, motion=(), has_line=True, is_watching=True
):
    """Returns arguments for karts that saw some of their rivals in the previous step."""
    chance = np.random.default_rng(seed)
    line = winding_road(chance, count)
    karts, items = (
        chance.normal([0, 0, 8], [5, 1.5, 12], (count, number, 3)).astype(np.float32)
        for number in (num_karts, num_items)
    )
    karts[chance.random((count, num_karts)) < 0.2] = np.inf
    types = chance.choice([*ItemType, -1, 99], (count, num_items)).astype(np.int64)
    road = np.concatenate([line[:, :5, :4], line[..., :4]], axis=1)
    around = Surroundings(own_of(chance, count), road, karts, items, types)
    moments = DriverMemory(count, RULES).moments
    spots, velocity, headings = plan_viewer.moment_of(moments[:, 0])
    spots[:, : min(num_karts, 3)] = np.where(np.isfinite(karts), karts, 1e3)[:, :3, ::2]
    spots += chance.normal(size=spots.shape)
    velocity[:] = around.ego[:, [0, 2]]
    headings[:] = plan_viewer.headings_of(winding_road(chance, count))
    out = (
        np.empty((3, count, 4), np.float32),
        np.empty((count, 3), np.float32),
        np.empty((count, 15), np.float32),
        np.zeros((count, INPUT_SIZE), np.float32),
    )
    numbers, worths, table, _, logits = plan_parts(RULES)
    return (
        (numbers, worths, table, motion, logits),
        memory_of(chance, count),
        around.arrays,
        line if has_line else None,
        moments if is_watching else None,
        out,
        SIZE,
    )


def planned(plan, arguments):
    """Returns the arrays that a function of plans writes, by name."""
    *given, moments, out, first = arguments
    moments, out = None if moments is None else moments.copy(), tuple(a.copy() for a in out)
    plan(*given, moments, out, first)
    names = ("best", "scene", "prior", "inputs")
    return dict(zip(names, out, strict=True)) | ({} if moments is None else {"moments": moments})


def assert_planned(ours, theirs, worth=1e-3):
    """Compares results; if two plans have nearly the same worth, either can be the best one."""
    np.testing.assert_allclose(ours["best"][0], theirs["best"][0], rtol=1e-4, atol=worth)
    for name in ("scene", "moments"):
        if name in theirs:
            np.testing.assert_allclose(ours[name], theirs[name], rtol=2e-6, atol=2e-5)
    for name in ("best", "prior", "inputs"):
        is_close = np.isclose(ours[name], theirs[name], rtol=1e-3, atol=1e-2)
        assert is_close.mean() > 0.97, name


@pytest.mark.parametrize(
    "sizes",
    [
        {},
        {"num_karts": 0},
        {"num_karts": 2, "has_line": False},
        {"num_items": 0},
        {"num_items": 3, "is_watching": False},
    ],
    ids=str,
)
@pytest.mark.parametrize("motion", [(), learned_motion()], ids=["arcs", "network"])
@pytest.mark.parametrize("seed", range(5))
def test_plans_match_the_oracle(seed, motion, sizes):
    arguments = scene_arguments(seed, **sizes, motion=motion)
    ours, theirs = (planned(f.plan_karts, arguments) for f in (_planning, plan_viewer))
    assert_planned(ours, theirs, worth=1e-2 if motion else 1e-3)
    assert ours["inputs"][:, SIZE:].any()
    assert sizes or len(np.unique(ours["prior"][:, -4:], axis=0)) > 1


@pytest.mark.parametrize("plan", [_planning.plan_karts, plan_viewer.plan_karts])
def test_each_side_of_the_road_has_its_own_edge(plan):
    arguments = scene_arguments(0, count=3)
    line = arguments[3]
    line[:] = 0
    line[..., 2], line[..., 3:] = MARK_SPACING * np.arange(MARK_COUNT + 1), (2.0, 5.0)
    line[..., 0] = [[-4.0], [0.0], [3.0]]  # karts to the right of the line, on it, to the left
    beyond = planned(plan, arguments)["scene"][:, 2]
    np.testing.assert_allclose(beyond, [4.0 - 5.0, -2.0, 3.0 - 2.0], atol=1e-5)


def test_the_prior_needs_no_inputs():
    *given, out, first = scene_arguments(0)
    full = planned(_planning.plan_karts, (*given, out, first))
    alone = planned(_planning.plan_karts, (*given, (*out[:3], out[3][:0].copy()), first))
    assert (alone["prior"] == full["prior"]).all()


@pytest.mark.parametrize("motion", [(), learned_motion()], ids=["arcs", "network"])
def test_results_do_not_depend_on_the_batch(motion):
    arguments = scene_arguments(0, count=9, motion=motion)
    together = planned(_planning.plan_karts, arguments)
    plans, memory, around, line, moments, out, first = arguments
    for kart in range(9):
        one = slice(kart, kart + 1)
        part = (
            plans,
            memory[:, one].copy(),
            tuple(a[one] for a in around),
            line[one],
            moments[one],
        )
        alone = planned(
            _planning.plan_karts,
            (*part, (out[0][:, one].copy(), *(a[one] for a in out[1:])), first),
        )
        assert (alone["best"][:, 0] == together["best"][:, kart]).all()
        for name in ("scene", "prior", "inputs", "moments"):
            assert (alone[name][0] == together[name][kart]).all()


@pytest.mark.parametrize("part", range(6))
def test_nan_in_the_network_reaches_the_worth_of_plans(part):
    motion = tuple(array.copy() for array in learned_motion())
    motion[part].flat[0] = np.nan
    arguments = scene_arguments(0, motion=motion)
    with np.errstate(invalid="ignore"):
        ours, theirs = (planned(f.plan_karts, arguments)["best"] for f in (_planning, plan_viewer))
    assert np.isnan(ours[0]).any()
    np.testing.assert_array_equal(np.isnan(ours), np.isnan(theirs))


@pytest.mark.parametrize("span", [np.nan, -1.0, np.inf, 1e9])
def test_spans_that_would_never_end_are_refused(span):
    (numbers, worths, table, motion, logits), *rest = scene_arguments(0, motion=learned_motion())
    spans = table.spans.copy()
    spans[-1] = span
    plans = numbers, worths, table._replace(spans=spans), motion, logits
    with pytest.raises(ValueError, match="at most 100 s"):
        _planning.plan_karts(plans, *rest)


def test_a_plan_for_an_item_out_of_range_ignores_it():
    (numbers, worths, table, motion, logits), *rest = scene_arguments(0)
    lost, none = (
        planned(
            _planning.plan_karts,
            ((numbers, worths, table._replace(items=items), motion, logits), *rest),
        )
        for items in (np.full_like(table.items, 10**6), np.full_like(table.items, -1))
    )
    assert (lost["best"] == none["best"]).all()
