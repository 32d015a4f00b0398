"""Observations, memory and actions of learned drivers, for batches of karts."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from stkzoo import race_v0
from stkzoo.agents import pretrained
from stkzoo.agents.planning.driver import (
    ALL_LOOKS,
    CHOICES,
    HEADS,
    PlanDriver,
    mirrored_choices,
    mirrored_inputs,
    mirrored_prior,
)
from stkzoo.agents.planning.memory import MEMORY_MIRROR
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.driver import read_numbers, read_policy
from stkzoo.errors import ConfigError
from stkzoo.wrappers.racing import (
    Surroundings,
    ground_observer,
    surroundings_of,
)
from tests.oracle.plan_viewer import moment_of
from tests.support.generic_env import full_views

SIDE = np.array([-1, 1, 1], np.float32)


HOLD = DriverParameters(turn_hold=4)


def best(prior):
    return np.stack([prior[:, head].argmax(axis=1) for head in HEADS], axis=1)


def driven_race(steps, karts=3, track="lighthouse", rules=None, choose=best):
    """Drives a race with a policy; yields the environment, surroundings, drivers and views."""
    controls_of = ("acceleration", "steer", "brake", "drift", "fire", "nitro", "rescue")
    with race_v0.parallel_env(num_kart=karts, track=track, max_paths=96) as env:
        env.reset(seed=3)
        drivers = PlanDriver(karts, rules)
        for _ in range(steps):
            around = surroundings_of(full_views(env), ALL_LOOKS)
            if env.snapshot.phase < 2:
                controls = np.zeros((karts, 7), np.float32)
                controls[:, 0] = 1
            else:
                view = drivers.look(around)
                yield env, around, drivers, view
                controls, _ = drivers.act(choose(view.prior))
            env.step(
                {
                    agent: {
                        key: row[n : n + 1] if n < 2 else int(row[n])
                        for n, key in enumerate(controls_of)
                    }
                    for agent, row in zip(env.agents, controls, strict=True)
                }
            )


def rows_of(around, rows):
    seen = {field.name: getattr(around, field.name) for field in dataclasses.fields(around)}
    return Surroundings(**{name: a[rows] for name, a in seen.items() if a is not None})


def memories(drivers):
    """Returns the drivers' memory by name, as arrays with one row per kart."""
    spots, velocity, headings = moment_of(drivers.memory.moments[:, 0])
    before = {"spots": spots, "velocity": velocity, "headings": headings}
    return drivers.memory._of._asdict() | before


def remembered(drivers):
    return {name: array.copy() for name, array in memories(drivers).items()}


def remind(drivers, state):
    for name, array in memories(drivers).items():
        array[:] = state[name]


@pytest.mark.slow
def test_the_prior_alone_drives_forward():
    for env, *_ in driven_race(150):
        moment = env.snapshot
    assert (moment.karts["overall_distance"] > 120).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ace", "scout"])
def test_decisions_do_not_depend_on_the_batch_size(name):
    folder = Path(pretrained.__file__).parent / name
    policy, rules = read_policy(folder), read_numbers(folder)
    together = PlanDriver(3, rules)
    alone = [PlanDriver(1, rules) for _ in range(3)]
    for _, around, *_ in driven_race(60):
        controls, _ = together.act(policy.best(together.look(around)))
        for kart, driver in enumerate(alone):
            seen = driver.look(rows_of(around, [kart]))
            decided, _ = driver.act(policy.best(seen))
            np.testing.assert_array_equal(decided[0], controls[kart])


@pytest.mark.slow
def test_plans_on_the_racing_line_follow_it():
    on_line = DriverParameters(racing_line=True)
    with race_v0.parallel_env(num_kart=2, track="hacienda", view="ground") as env:
        observations, _ = env.reset(seed=3)
        drivers = {agent: PlanDriver(1, on_line) for agent in env.agents}
        observer = ground_observer(env.track_map, env.ground)
        misses = []
        for _ in range(120):
            seen = [observations[agent] for agent in env.agents]
            around = surroundings_of(seen)
            karts = np.array(env.race.kart_indices)
            ahead = observer.observe(env.snapshot, karts)
            line = np.concatenate([ahead["ground_line"], ahead["ground_room"]], axis=-1)
            np.testing.assert_array_equal(around.line, line)
            actions = {agent: drivers[agent].drive(observations[agent]) for agent in env.agents}
            misses.append([abs(float(one["ground_line"][0, 0])) for one in seen])
            observations, *_ = env.step(actions)
    assert np.median(misses[60:]) < 3  # plans stay near the line, in lanes beside it


def test_plans_on_the_racing_line_refuse_observations_without_it():
    with race_v0.parallel_env(num_kart=1, track="hacienda") as env:
        observations, _ = env.reset(seed=3)
        driver = PlanDriver(1, DriverParameters(racing_line=True))
        while observations["kart_0"]["phase"] < 2:
            observations, *_ = env.step({"kart_0": driver.drive(observations["kart_0"])})
        with pytest.raises(ConfigError, match="no ground_line; give the agent the view 'ground'"):
            driver.drive(observations["kart_0"])


def mirrored_race(around):
    finite = np.isfinite(around.karts)
    karts = np.where(finite, around.karts, 0) * SIDE
    own, road = around.ego.copy(), around.road * np.array([-1, 1, 1, 1], np.float32)
    own[:, 0] *= -1
    return Surroundings(
        own, road, np.where(finite, karts, np.inf), around.items * SIDE, around.item_types
    )


def test_a_mirrored_race_gives_mirrored_inputs():
    signs = dict.fromkeys(remembered(PlanDriver(1)), 1.0)
    signs |= dict.fromkeys(("turn", "drift_turn", "drift_side", "held_offset"), -1.0)
    signs |= dict.fromkeys(("spots", "velocity"), np.array([-1, 1], np.float32))
    signs |= {"headings": -1.0}
    for count, (_, around, drivers, view) in enumerate(driven_race(110)):
        if count % 15:
            continue
        twin = PlanDriver(3)
        remind(twin, {n: row * signs[n] for n, row in remembered(drivers).items()})
        seen = twin.view(mirrored_race(around))
        np.testing.assert_allclose(seen.inputs, mirrored_inputs(view.inputs), atol=2e-3)
        np.testing.assert_allclose(seen.prior, mirrored_prior(view.prior), atol=2e-2)
        assert (twin.memory.numbers() == drivers.memory.numbers() * MEMORY_MIRROR).all()


def test_mirrored_choices_steer_to_the_other_side():
    *_, (_, around, _, _) = driven_race(70)
    here, there = PlanDriver(3), PlanDriver(3)
    view = here.view(around)
    there.view(mirrored_race(around))
    choices = best(view.prior)
    ours, _ = here.act(choices)
    theirs, _ = there.act(mirrored_choices(choices))
    np.testing.assert_allclose(theirs[:, 1], -ours[:, 1], atol=1e-3)
    np.testing.assert_allclose(np.delete(theirs, 1, 1), np.delete(ours, 1, 1))


def offsets_of(seed):
    """Returns a policy that samples its offsets, and a list of the choices that it has made."""
    random, made = np.random.default_rng(seed), []

    def choose(prior):
        noise = random.gumbel(size=prior.shape)
        noise[:, HEADS[1]] *= 9  # so that all offsets are likely
        made.append(best(prior + noise))
        return made[-1]

    return choose, made


def test_an_offset_holds_for_the_given_number_of_steps():
    choose, made = offsets_of(0)
    for *_, drivers, view in driven_race(60, rules=HOLD, choose=choose):
        if len(made) % 4:
            held, left = drivers.memory.held()
            np.testing.assert_allclose(left, 1 - len(made) % 4 / 4)
            np.testing.assert_array_equal(view.inputs[:, -2], held)
            np.testing.assert_array_equal(view.inputs[:, -1], left)
    drawn = np.array(made[: len(made) // 4 * 4])[:, :, 1].reshape(-1, 4, 3)
    assert (drawn == drawn[:, :1]).all()
    assert len(np.unique(drawn[:, 0])) == CHOICES[1]


def test_an_offset_of_one_step_is_not_an_input():
    choose, _ = offsets_of(2)
    for *_, view in driven_race(40, choose=choose):
        assert not view.inputs[:, -2:].any()
