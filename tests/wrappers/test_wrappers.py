from __future__ import annotations

import copy

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from stkzoo.errors import ConfigError
from stkzoo.mdp.spaces import kart_observation_space
from stkzoo.wrappers import (
    CompiledWrapper,
    ConstantSizedObservations,
    DiscreteActionsWrapper,
    Discretizer,
    FlattenerWrapper,
    FlattenMultiDiscreteActions,
    OnlyContinuousActionsWrapper,
    PolarObservations,
    SpaceFlattener,
)
from tests.support.generic_env import (
    VIEWS,
    assert_same,
    import_reference,
    kart_env,
    random_batch,
    split,
    wrap,
    wrap_as_reference,
)

reference_stk = import_reference("stk_wrappers")

FIXED_SIZE = [view for view in VIEWS if view != "full"]


def observe(env, obs):
    """Runs an observation through a stack of wrappers."""
    if not isinstance(env, gym.Wrapper):
        return obs
    obs = observe(env.env, obs)
    return env.observation(obs) if hasattr(type(env), "observation") else obs


def act(env, action):
    """Runs an action through a stack of wrappers."""
    while isinstance(env, gym.Wrapper):
        action = env.action(action) if hasattr(type(env), "action") else action
        env = env.env
    return action


def singles(seed, count=40, use_ai=False):
    """Yields random full observations with lists of different lengths."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        items, karts, paths = rng.integers(1, 12, size=3)
        batch = random_batch(rng, 1, items=items, karts=karts, paths=paths, use_ai=use_ai)
        yield split(kart_observation_space(use_ai), batch)[0]


def without_text(obs):
    return {key: value for key, value in obs.items() if key != "kart_type"}


@pytest.mark.slow
@pytest.mark.parametrize("view", FIXED_SIZE)
def test_observations_match_the_reference(view):
    ours, theirs = wrap(kart_env(), view), wrap_as_reference(kart_env(), view)
    for obs in singles(1, 80):
        expected = observe(theirs, copy.deepcopy(obs))
        if view != "simple":
            expected = without_text(expected)
        assert_same(observe(ours, obs), expected)


@pytest.mark.parametrize("mask", [False, True])
def test_constant_size_matches_the_reference_for_other_sizes(mask):
    arguments = {"state_items": 3, "state_karts": 2, "state_paths": 10, "add_mask": mask}
    ours = ConstantSizedObservations(kart_env(), **arguments)
    theirs = reference_stk.ConstantSizedObservations(kart_env(), **arguments)
    assert ours.observation_space == theirs.observation_space
    for obs in singles(2):
        assert_same(ours.observation(obs), theirs.observation(obs))


@pytest.mark.parametrize("view", FIXED_SIZE)
def test_spaces_match_the_reference_without_text(view):
    ours, theirs = wrap(kart_env(), view), wrap_as_reference(kart_env(), view)
    assert ours.action_space == theirs.action_space
    expected = theirs.observation_space.spaces
    expected = expected if view == "simple" else without_text(expected)
    assert ours.observation_space == spaces.Dict(expected)


@pytest.mark.parametrize("view", FIXED_SIZE)
def test_actions_match_the_reference(view):
    ours, theirs = wrap(kart_env(), view), wrap_as_reference(kart_env(), view)
    ours.action_space.seed(4)
    for _ in range(200):
        action = ours.action_space.sample()
        mine, expected = act(ours, action), act(theirs, action)
        assert mine.keys() == expected.keys()
        for key in expected:
            assert np.float32(mine[key]).item() == np.float32(expected[key]).item()


@pytest.mark.parametrize("use_ai", [False, True])
@pytest.mark.parametrize("view", VIEWS)
def test_observations_are_in_their_space(view, use_ai):
    env = wrap(kart_env(use_ai), view)
    for obs in singles(6, use_ai=use_ai):
        assert observe(env, obs) in env.observation_space


@pytest.mark.parametrize("view", FIXED_SIZE[1:])
def test_an_observed_ai_action_is_declared_in_the_flattened_action_space(view):
    env = wrap(kart_env(use_ai=True), view)
    assert env.observation_space["action"] == env.action_space


@pytest.mark.parametrize("view", VIEWS)
def test_empty_lists_can_be_observed(view):
    env = wrap(kart_env(), view)
    batch = random_batch(np.random.default_rng(11), 3, items=0, karts=0)
    for obs in split(kart_observation_space(), batch):
        assert observe(env, obs) in env.observation_space


def test_masks_tell_real_rows_from_padding():
    env = ConstantSizedObservations(kart_env(), add_mask=True)
    batch = random_batch(np.random.default_rng(12), 1, items=2, karts=0, paths=9)
    masks = env.observation(split(kart_observation_space(), batch)[0])
    assert masks["items_mask"].tolist() == [1, 1, 0, 0, 0]
    assert masks["karts_mask"].tolist() == [0] * 5
    assert masks["paths_mask"].tolist() == [1] * 5


def test_polar_angles_are_positive_to_the_right_and_above():
    env = PolarObservations(kart_env())
    obs = next(singles(14))
    obs["center_path"] = np.array([1, 1, 1], np.float32)
    expected = [np.pi / 4, np.pi / 4, np.sqrt(3)]
    np.testing.assert_allclose(env.observation(obs)["center_path"], expected, rtol=1e-6)


@pytest.mark.parametrize("value", [0, 2.5, None, True, "5"])
def test_invalid_sizes_and_steps_are_refused(value):
    for key in ("state_items", "state_karts", "state_paths"):
        with pytest.raises(ConfigError, match=f"{key} is .*of 1 or more"):
            ConstantSizedObservations(kart_env(), **{key: value})
    for key in ("acceleration_steps", "steer_steps"):
        with pytest.raises(ConfigError, match=f"{key} is .*of 2 or more"):
            DiscreteActionsWrapper(kart_env(), **{key: 1 if value is True else value})


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: ConstantSizedObservations(wrap(kart_env(), "simple")), "only once"),
        (lambda: PolarObservations(wrap(kart_env(), "flattened")), "found no positions"),
        (lambda: PolarObservations(wrap(kart_env(), "simple")), "only once"),
        (
            lambda: PolarObservations(ConstantSizedObservations(PolarObservations(kart_env()))),
            "found PolarObservations inside it.* only once",
        ),
        (lambda: FlattenerWrapper(kart_env()), "ConstantSizedObservations inside"),
        (lambda: FlattenMultiDiscreteActions(kart_env()), "MultiDiscrete action space"),
        (lambda: DiscreteActionsWrapper(wrap(kart_env(), "flattened")), "'acceleration'"),
        (
            lambda: OnlyContinuousActionsWrapper(DiscreteActionsWrapper(kart_env())),
            "only discrete actions",
        ),
        (
            lambda: OnlyContinuousActionsWrapper(wrap(kart_env(), "flattened")),
            "cannot release 'discrete'.* inside the wrappers that flatten",
        ),
    ],
)
def test_a_wrapper_in_the_wrong_place_is_an_error(make, text):
    with pytest.raises(ConfigError, match=text) as caught:
        make()
    assert len(str(caught.value)) < 600


@given(st.integers(2, 101), st.floats(-1, 1))
def test_the_nearest_step_is_at_most_half_a_step_away(values, number):
    steps = Discretizer(spaces.Box(-1, 1, (1,)), values)
    distance = abs(steps.continuous(steps.discretize(number)) - number)
    assert distance <= 1 / (values - 1) + 1e-9


def test_actions_can_be_discretized_under_the_names_of_the_reference():
    wrapper = DiscreteActionsWrapper(kart_env(), acceleration_steps=5, steer_steps=7)
    action = {**kart_env().action_space.sample(), "acceleration": 0.5, "steer": np.ones(1)}
    steps = wrapper.to_discrete(action)
    assert (steps["acceleration"], steps["steer"]) == (2, 6)
    numbers = wrapper.from_discrete(steps)
    assert (numbers["acceleration"].item(), numbers["steer"].item()) == (0.5, 1.0)
    assert wrapper.to_discrete(numbers) == steps


@pytest.mark.parametrize(("number", "step"), [(-1.5, 0), (1.0000001, 6), (7.0, 6)])
def test_numbers_out_of_bounds_are_clipped(number, step):
    assert Discretizer(spaces.Box(-1, 1, (1,)), 7).discretize(number) == step


@pytest.mark.slow
@given(
    npst.arrays(np.float32, (2,), elements=st.floats(-1, 1, width=32)),
    npst.arrays(np.int64, (4,), elements=st.integers(0, 1)),
)
def test_flattening_undoes_unflattening(continuous, discrete):
    space = spaces.Dict(
        {
            "b": spaces.Box(-1, 1, (1, 2)),
            "d": spaces.MultiDiscrete([2, 2]),
            "a": spaces.Discrete(2),
            "c": spaces.Discrete(2, start=1),
        }
    )
    flattener = SpaceFlattener(space)
    flat = {"continuous": continuous, "discrete": discrete}
    assert_same(flattener.flatten(flattener.unflatten(flat)), flat)


def test_a_space_with_nothing_to_flatten_is_refused():
    with pytest.raises(ConfigError, match="nothing to flatten"):
        SpaceFlattener(spaces.Dict({"name": spaces.Text(3)}))


def test_every_combination_of_choices_has_its_own_number():
    env = wrap(kart_env(use_ai=True), "flattened_discrete")
    numbers = np.arange(env.action_space.n)
    choices = env.action(numbers)
    assert len(np.unique(choices, axis=0)) == len(numbers)
    assert [env.observed_action(row) for row in choices] == numbers.tolist()


def test_flattening_only_actions_keeps_the_observation():
    env = FlattenerWrapper(kart_env(use_ai=True), flatten_observations=False)
    obs = next(singles(15, use_ai=True))
    seen = env.observation(obs)
    assert seen in env.observation_space
    assert_same(
        {k: v for k, v in seen.items() if k != "action"},
        {k: v for k, v in obs.items() if k != "action"},
    )


def test_a_spec_keeps_arguments_that_are_not_the_defaults():
    spec = EnvSpec("generic/kart-v0", entry_point=kart_env)
    env = DiscreteActionsWrapper(spec.make(disable_env_checker=True), steer_steps=3)
    assert env.spec.make(disable_env_checker=True).action_space["steer"].n == 3


def test_a_subclass_is_not_compiled_unless_it_says_so():
    class Mine(PolarObservations):
        pass

    class Kept(PolarObservations, CompiledWrapper):
        pass

    assert not Mine(kart_env()).keeps_promise()
    assert Kept(kart_env()).keeps_promise()
