"""What learned drivers see, remember and do, for many karts at once."""

import dataclasses

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.agents.planning import (
    ALL_LOOKS,
    CHOICES,
    HEADS,
    INPUT_SIZE,
    DriverParameters,
    PlanDriver,
    PolicyInput,
    mirrored_choices,
    mirrored_inputs,
    mirrored_prior,
)
from stkzoo.agents.planning.kart import (
    BOOST_LASTS,
    BOOST_STEPS,
    DRIFT_APART,
    RESCUE_STEPS,
    STEP,
)
from stkzoo.agents.planning.memory import MEMORY_MIRROR, DriverMemory
from stkzoo.agents.planning.plans import (
    BRAKE,
    DRIFT_LEFT,
    DRIFT_RIGHT,
    FREE,
    plan_table,
    table_rows,
)
from stkzoo.agents.pretrained.policy import RacingPolicy
from stkzoo.wrappers.racing import BatchedRacingView, RoadTable, Surroundings, surroundings_of

STRAIGHT = CHOICES[1] // 2
SIDE = np.array([-1, 1, 1], np.float32)


def best(prior):
    return np.stack([prior[:, head].argmax(axis=1) for head in HEADS], axis=1)


def driven_race(steps, karts=3, track="lighthouse"):
    """Moments of a race that the prior drives: what the karts know, and the drivers then."""
    controls_of = ("acceleration", "steer", "brake", "drift", "fire", "nitro", "rescue")
    with race_v0.parallel_env(num_kart=karts, track=track, max_paths=96) as env:
        env.reset(seed=3)
        drivers = PlanDriver(karts)
        for _ in range(steps):
            own, around = surroundings_of(env.observe_batch(env.agents), ALL_LOOKS)
            if env.snapshot.phase < 2:
                controls = np.zeros((karts, 7), np.float32)
                controls[:, 0] = 1
            else:
                view = drivers.look(own, around)
                yield env, own, around, drivers, view
                controls, _ = drivers.act(best(view.prior))
            env.step(
                {
                    agent: {
                        key: row[n : n + 1] if n < 2 else int(row[n])
                        for n, key in enumerate(controls_of)
                    }
                    for agent, row in zip(env.agents, controls, strict=True)
                }
            )


def rows_of(own, around, rows):
    parts = {f.name: getattr(around, f.name)[rows] for f in dataclasses.fields(around)}
    return {key: value[rows] for key, value in own.items()}, Surroundings(**parts)


def test_the_prior_alone_drives():
    for env, *_ in driven_race(150):
        moment = env.snapshot
    assert (moment.karts["overall_distance"] > 120).all()


def test_karts_see_together_what_each_sees_alone():
    for count, (_, own, around, drivers, view) in enumerate(driven_race(110)):
        if count % 20:
            continue
        for kart in range(3):
            alone = PlanDriver(1)
            alone.restore({name: row[[kart]] for name, row in drivers.state().items()})
            seen = alone.view(*rows_of(own, around, [kart]))
            np.testing.assert_allclose(seen.inputs[0], view.inputs[kart], atol=1e-3)
            np.testing.assert_allclose(seen.prior[0], view.prior[kart], atol=1e-2)
    assert view.inputs.shape == (3, INPUT_SIZE)
    assert np.isfinite(view.inputs).all()


def test_a_crowd_sees_what_the_full_view_tells():
    crowd = None
    for count, (env, own, around, *_) in enumerate(driven_race(90)):
        crowd = crowd or BatchedRacingView([RoadTable(env.track_map)])
        if count % 15:
            continue
        karts = np.array(env.race.kart_indices)
        own_too, around_too = crowd.surroundings([env.snapshot], [0], [karts], ALL_LOOKS)
        here, there = PlanDriver(3).view(own, around), PlanDriver(3).view(own_too, around_too)
        np.testing.assert_allclose(here.inputs, there.inputs, atol=1e-3)
        np.testing.assert_allclose(here.prior, there.prior, atol=1e-2)


def mirrored_race(own, around):
    finite = np.isfinite(around.karts)
    karts = np.where(finite, around.karts, 0) * SIDE
    road = around.road * np.array([-1, 1, 1, 1], np.float32)
    return {**own, "velocity": own["velocity"] * SIDE}, Surroundings(
        road, np.where(finite, karts, np.inf), around.items * SIDE, around.item_types
    )


def test_the_mirrored_race_is_seen_mirrored():
    signs = dict.fromkeys(PlanDriver(1).state(), 1.0)
    signs |= {"turn": -1.0, "drift_turn": -1.0, "drift_side": -1.0}
    signs |= dict.fromkeys(("rivals spots", "rivals velocity"), np.array([-1, 1], np.float32))
    signs |= {"rivals headings": -1.0}
    for count, (_, own, around, drivers, view) in enumerate(driven_race(110)):
        if count % 15:
            continue
        twin = PlanDriver(3)
        twin.restore({n: row * signs[n] for n, row in drivers.state().items()})
        seen = twin.view(*mirrored_race(own, around))
        np.testing.assert_allclose(seen.inputs, mirrored_inputs(view.inputs), atol=2e-3)
        np.testing.assert_allclose(seen.prior, mirrored_prior(view.prior), atol=2e-2)
        assert (twin.memory.numbers() == drivers.memory.numbers() * MEMORY_MIRROR).all()


def test_mirroring_twice_changes_nothing():
    chance = np.random.default_rng(0)
    inputs = chance.normal(size=(4, INPUT_SIZE)).astype(np.float32)
    prior = chance.normal(size=(4, sum(CHOICES))).astype(np.float32)
    choices = np.stack([chance.integers(0, n, 9) for n in CHOICES], axis=1)
    assert (mirrored_inputs(mirrored_inputs(inputs)) == inputs).all()
    assert (mirrored_prior(mirrored_prior(prior)) == prior).all()
    assert (mirrored_choices(mirrored_choices(choices)) == choices).all()
    assert mirrored_choices(np.array([[DRIFT_LEFT, 0, 1, 0]])).tolist() == [
        [DRIFT_RIGHT, CHOICES[1] - 1, 1, 0]
    ]


def test_mirrored_choices_steer_the_other_way():
    *_, (_, own, around, _, _) = driven_race(70)
    here, there = PlanDriver(3), PlanDriver(3)
    view = here.view(own, around)
    there.view(*mirrored_race(own, around))
    choices = best(view.prior)
    ours, _ = here.act(choices)
    theirs, _ = there.act(mirrored_choices(choices))
    np.testing.assert_allclose(theirs[:, 1], -ours[:, 1], atol=1e-3)
    np.testing.assert_allclose(np.delete(theirs, 1, 1), np.delete(ours, 1, 1))


def test_plans_know_their_state():
    rows = table_rows(np.array([0, 0, 1, -1]), np.array([0, 0, 5, 99]), np.array([0, 3, 0, 0]))
    begins = [set(plan_table(4).manoeuvres[row].tolist()) - {-1} for row in rows]
    assert begins[0] == {FREE, BRAKE, DRIFT_LEFT, DRIFT_RIGHT}
    assert begins[1] == {FREE, BRAKE}  # the last drift must end first; then a new one may be
    assert begins[2] == {FREE, BRAKE, DRIFT_RIGHT}
    assert begins[3] == {FREE, BRAKE}  # nothing more is to be earned
    assert (plan_table(4).least <= plan_table(4).most).all()


def test_a_drift_is_remembered_with_what_it_earns():
    memory, one = DriverMemory(1, DriverParameters()), np.array([1.0], np.float32)
    side, none = np.array([1]), np.array([False])
    fast, skids = 20 * one, 2 * one
    for _ in range(BOOST_STEPS[0]):
        memory.look(fast, skids)
        memory.act(side, 0.5 * one, none, none)
    assert memory.situation().drift_steps[0] == BOOST_STEPS[0]
    memory.act(0 * side, 0 * one, none, none)
    now = memory.situation()
    assert (now.drift_side[0], now.boost_steps[0]) == (0, BOOST_LASTS[0])
    assert now.drift_turn[0] == 0.5
    memory.look(fast, one)
    assert memory.situation().boost_steps[0] == BOOST_LASTS[0] - 1


def test_a_drift_that_the_engine_ends_is_over():
    memory, one = DriverMemory(1, DriverParameters()), np.array([1.0], np.float32)
    none = np.array([False])
    for step in range(6):
        memory.look(20 * one, one)  # it does not skid
        if step < 4:
            memory.act(np.array([1]), 0.5 * one, none, none)
    assert memory.situation().drift_side[0] == 0


def test_a_drift_begins_with_a_hop_and_after_a_short_one_the_kart_turns_on_for_short():
    memory, one = DriverMemory(1, DriverParameters()), np.array([1.0], np.float32)
    none, may_hop = np.array([False]), []
    for step in range(DRIFT_APART + 1):
        memory.look(20 * one, 2 * one)
        may_hop.append(bool(memory.situation().may_hop[0]))
        memory.act(np.array([int(step < 2)]), 0.5 * one, none, none)
        if step == 2:
            assert memory.situation().release_steps[0] == 2
    assert may_hop == [True, *[False] * (DRIFT_APART - 1), True]


def when_a_held_kart_acts(speed=0.0, **rules):
    """In which steps one that does not get away backs out, and calls the rescue."""
    memory, speeds = DriverMemory(1, DriverParameters(**rules)), np.full(1, speed, np.float32)
    backs, calls = [], []
    for step in range(60):
        memory.look(speeds, np.ones(1))
        back, call = memory.stuck()
        backs += [step] * int(back[0])
        calls += [step] * int(call[0])
    return backs, calls


def test_who_is_stuck_calls_the_rescue_and_gives_it_time():
    backs, calls = when_a_held_kart_acts()
    assert calls[0] < backs[0] < calls[1]  # it backs out, since the first rescue did not help
    assert calls[0] == pytest.approx(DriverParameters().stuck_time / STEP, abs=1)
    assert min(np.diff(calls)) >= RESCUE_STEPS


def test_who_is_stuck_may_back_out_first():
    backs, calls = when_a_held_kart_acts(rescue_reverses=1)
    assert calls[0] > backs[0] + 9


def test_who_crawls_along_an_obstacle_calls_the_rescue():
    rules = DriverParameters()
    assert when_a_held_kart_acts(rules.crawl_speed + 0.5) == ([], [])
    _, calls = when_a_held_kart_acts(rules.crawl_speed - 0.5)
    assert calls[0] == pytest.approx(rules.crawl_time / STEP, abs=1)


def test_who_is_lost_calls_the_rescue():
    rules = DriverParameters()
    memory, fast = DriverMemory(2, rules), np.full(2, 20.0, np.float32)
    beyond = rules.lost_room + np.array([-0.5, 0.5], np.float32)
    calls = np.zeros(2, int)
    for _ in range(20):
        memory.look(fast, fast)
        memory.look_around(beyond)
        calls += memory.stuck()[1]
    assert calls.tolist() == [0, 1]


def test_some_karts_are_forgotten_and_others_not():
    memory, twos = DriverMemory(2, DriverParameters()), np.ones(2, np.float32)
    nobody = np.zeros(2, bool)
    memory.look(20 * twos, 2 * twos)
    memory.act(np.array([1, 1]), 0.3 * twos, nobody, ~nobody)
    memory.forget(np.array([0]))
    one, two = memory.numbers()
    assert (one == DriverMemory(1, DriverParameters()).numbers()[0]).all()
    assert (two != one).any()
    twin = DriverMemory(2, DriverParameters())
    twin.restore(memory.state())
    assert (twin.numbers() == memory.numbers()).all()


def flat_policy(**last):
    weights = {
        "mean": np.zeros(INPUT_SIZE, np.float32),
        "scale": np.ones(INPUT_SIZE, np.float32),
    }
    sizes = (INPUT_SIZE, 4, 4, sum(CHOICES))
    for layer in range(3):
        weights[f"w{layer}"] = np.zeros(sizes[layer : layer + 2], np.float32)
        weights[f"b{layer}"] = np.zeros(sizes[layer + 1], np.float32)
    return RacingPolicy(weights | last)


def test_sampled_choices_follow_their_probabilities():
    prior = np.zeros((4000, sum(CHOICES)), np.float32)
    prior[:, HEADS[2]] = 0.0, np.log(3.0)
    view = PolicyInput(np.zeros((4000, INPUT_SIZE), np.float32), prior)
    drawn, logs = flat_policy().sample(view, np.random.default_rng(0))
    assert drawn[:, 2].mean() == pytest.approx(0.75, abs=0.03)
    assert drawn[:, 0].mean() == pytest.approx(1.5, abs=0.1)
    flat = -np.log(CHOICES[0] * CHOICES[1] * 2)
    assert sorted(set(logs.round(4).tolist())) == pytest.approx(
        [flat + np.log(0.25), flat + np.log(0.75)], abs=1e-3
    )


def test_what_is_learned_is_added_to_the_prior():
    prior = np.zeros((1, sum(CHOICES)), np.float32)
    prior[0, FREE] = 2.0
    view = PolicyInput(np.zeros((1, INPUT_SIZE), np.float32), prior)
    learned = np.zeros(sum(CHOICES), np.float32)
    learned[BRAKE] = 3.0
    assert flat_policy().best(view)[0, 0] == FREE
    assert flat_policy(b2=learned).best(view)[0, 0] == BRAKE
