"""Copies and specs of all ids and wrapper stacks play the same race."""

import copy
import functools
import pickle

import cloudpickle
import gymnasium as gym
import pytest
from gymnasium import wrappers
from gymnasium.envs.registration import EnvSpec

import stkzoo
from stkzoo import race_v0
from stkzoo.views import VIEWS
from stkzoo.wrappers import (
    CameraObservations,
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    MonoAgentWrapperAdapter,
    OnlyContinuousActionsWrapper,
    PolarObservations,
)
from tests.support.playing import fingerprint, play, trace
from tests.support.views import marked

RACE = {"track": "lighthouse", "num_kart": 2}
NAMES = (
    *("full", "simple", "flattened", "flattened_continuous_actions"),
    *("flattened_multidiscrete", "flattened_discrete"),
)
IDS = [f"supertuxkart/{name}-v0" for name in (*NAMES, "multi-full")]
COPIES = {
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
    "cloudpickle": lambda env: cloudpickle.loads(cloudpickle.dumps(env)),
    "deepcopy": copy.deepcopy,
}


def of_id(env_id):
    return lambda: gym.make(env_id, **RACE)


def stacked(*layers, base="full"):
    def make():
        env = gym.make(f"supertuxkart/{base}-v0", **RACE)
        for layer, options in layers:
            env = layer(env, **options)
        return env

    return make


FLAT = [(ConstantSizedObservations, {"state_items": 3}), (PolarObservations, {})]
#: Stacks of stkzoo's and Gymnasium's wrappers.
STACKS = {
    "polar lists": stacked((PolarObservations, {})),
    "one number": stacked(
        *FLAT,
        (DiscreteActionsWrapper, {"acceleration_steps": 3, "steer_steps": 5}),
        (FlattenerWrapper, {}),
        (FlattenMultiDiscreteActions, {}),
        (wrappers.DelayObservation, {"delay": 1}),
    ),
    "numbers only": stacked(
        *FLAT,
        (OnlyContinuousActionsWrapper, {}),
        (FlattenerWrapper, {}),
        (wrappers.FlattenObservation, {}),
        (wrappers.FrameStackObservation, {"stack_size": 3}),
        (wrappers.NormalizeReward, {}),
        (wrappers.RecordEpisodeStatistics, {}),
    ),
    "camera": stacked(
        (CameraObservations, {"size": (32, 32), "backend": "map", "every": 2}),
        (wrappers.RecordEpisodeStatistics, {}),
        base="flattened_discrete",
    ),
}
#: Plain pickle does not support the functions inside Gymnasium's FlattenObservation.
NOT_PICKLED = ("numbers only",)
ALL = {**{env_id: of_id(env_id) for env_id in IDS}, **STACKS}


def race(env, steps=15, seed=7):
    """Returns fingerprints of a few steps with seeded random actions."""
    observation, info = env.reset(seed=seed)
    prints = [fingerprint([observation, without_times(info)])]
    space = copy.deepcopy(env.action_space)
    space.seed(1)
    for _ in range(steps):
        *step, info = env.step(space.sample())
        prints.append(fingerprint([*step, without_times(info)]))
        if step[-1] or step[-2]:
            break
    env.close()
    return prints


def without_times(info):
    return {key: value for key, value in info.items() if key != "episode"}


@functools.cache
def race_of(name):
    return race(ALL[name]())


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["before", "amid"])
@pytest.mark.parametrize(
    ("name", "library"),
    marked(
        [(n, c) for n in ALL for c in COPIES if not (n in NOT_PICKLED and c == "pickle")],
        kept=[("one number", c) for c in COPIES]
        + [(n, "cloudpickle") for n in ("numbers only", "camera", IDS[0], IDS[-1])],
    ),
)
def test_a_copy_plays_the_same_race(name, library, moment):
    with ALL[name]() as env:
        if moment == "amid":
            env.reset(seed=3)
            env.step(env.action_space.sample())
        again = COPIES[library](env)
        assert [type(layer) for layer in layers(again)] == [type(layer) for layer in layers(env)]
        assert race(again) == (race_of(name) if moment == "before" else race(env))


@pytest.mark.slow
@pytest.mark.parametrize("name", marked(ALL, [*STACKS, IDS[0], IDS[-1]]))
def test_a_spec_rebuilds_the_whole_stack(name):
    expected = race_of(name)
    with ALL[name]() as env:
        for spec in (env.spec, EnvSpec.from_json(env.spec.to_json()), copy.deepcopy(env.spec)):
            again = gym.make(spec)
            assert [type(layer) for layer in layers(again)] == [
                type(layer) for layer in layers(env)
            ]
            assert again.observation_space == env.observation_space
            assert race(again) == expected


def layers(env):
    while isinstance(env, gym.Wrapper):
        yield env
        env = env.env
    yield env


def discrete_polar(env):
    return DiscreteActionsWrapper(PolarObservations(ConstantSizedObservations(env)))


@pytest.mark.parametrize("library", COPIES)
def test_the_multi_agent_adapter_is_copied_with_its_wrappers(library):
    def make():
        env = gym.make("supertuxkart/multi-full-v0", **RACE, agents=[stkzoo.AgentSpec()] * 2)
        return MonoAgentWrapperAdapter(env, wrapper_factories={"0": discrete_polar, "1": None})

    with make() as env, COPIES[library](env) as again:
        assert race(again) == race(env)


def small_camera(env):
    return CameraObservations(VIEWS["flattened_discrete"](env), size=(32, 32), backend="map")


def parallel_race(env, steps=15):
    with env:
        return trace(play(env, 5, max_steps=steps))


@pytest.mark.slow
@pytest.mark.parametrize("moment", ["before", "amid"])
@pytest.mark.parametrize("library", COPIES)
def test_the_parallel_environment_is_copied(library, moment):
    with race_v0.parallel_env(**RACE, view="flattened_discrete", reward="placement") as env:
        if moment == "amid":
            env.reset(seed=1)
        assert parallel_race(COPIES[library](env)) == parallel_race(env)


def test_a_copy_of_the_parallel_environment_has_its_own_cameras():
    for copied in (copy.deepcopy, COPIES["cloudpickle"]):
        with race_v0.parallel_env(**RACE, view=small_camera) as env:
            again = copied(env)
        assert parallel_race(again) == parallel_race(env)


def test_a_copy_has_the_options_of_the_next_race():
    env = gym.make(IDS[0], **RACE).unwrapped
    env.laps, env.default_track = 2, "hacienda"
    core = race_v0.parallel_env(**RACE)
    core.max_cycles = 7
    for copied in COPIES.values():
        assert (copied(env).laps, copied(env).default_track) == (2, "hacienda")
        assert copied(core).max_cycles == 7


def test_the_aec_environment_is_copied():
    env = race_v0.env(**RACE, view="flattened_discrete")
    again = copy.deepcopy(env)
    results = []
    for each in (env, again):
        each.reset(seed=4)
        prints = []
        for _ in range(12):
            each.step(484)
            prints.append(fingerprint(list(each.last())))
        each.close()
        results.append(prints)
    assert results[0] == results[1]


def test_a_registered_user_view_is_copied_and_rebuilt():
    stkzoo.register_view("pickled_polar", discrete_polar)
    try:
        with gym.make("supertuxkart/pickled_polar-v0", **RACE) as env:
            expected = race(env)
            assert race(pickle.loads(pickle.dumps(env))) == expected
            assert race(gym.make(EnvSpec.from_json(env.spec.to_json()))) == expected
    finally:
        del VIEWS["pickled_polar"], gym.registry["supertuxkart/pickled_polar-v0"]
