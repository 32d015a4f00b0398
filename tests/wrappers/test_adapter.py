from __future__ import annotations

import pickle

import gymnasium as gym
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit
from pettingzoo import ParallelEnv
from pettingzoo.test import parallel_api_test

from stkzoo import STKRaceMultiEnv, race_v0
from stkzoo.errors import ConfigError
from stkzoo.wrappers import ConstantSizedObservations, MonoAgentWrapperAdapter, PolarObservations
from tests.support.generic_env import (
    Counter,
    MultiEnv,
    SmallRace,
    assert_same,
    import_reference,
    wrap,
    wrap_as_reference,
)

FORMS = {"parallel": (SmallRace, ("kart_0", "kart_1")), "gym": (MultiEnv, ("0", "1"))}


def simple(env):
    return wrap(env, "simple")


def discrete(env):
    return wrap(env, "flattened_discrete")


def two_items(env):
    return PolarObservations(ConstantSizedObservations(env, state_items=2))


class Wiper(gym.ObservationWrapper):
    """Overwrites the observation that it gets."""

    def observation(self, observation):
        observation["velocity"][:] = 0
        return observation


def space_of(env, agent):
    if isinstance(env, ParallelEnv):
        return env.observation_space(agent), env.action_space(agent)
    return env.observation_space[agent], env.action_space[agent]


def samples(env, agents):
    return {agent: space_of(env, agent)[1].sample() for agent in agents}


@pytest.fixture(params=FORMS)
def form(request):
    return FORMS[request.param]


class Bonus(MonoAgentWrapperAdapter):
    """A user's subclass, with its own arguments."""

    def __init__(self, env, bonus):
        super().__init__(env, wrapper_factories={0: discrete})
        self.bonus = bonus

    def reset(self, **options):
        observations, info = super().reset(**options)
        return observations, {**info, "bonus": self.bonus}


def test_a_subclass_wraps_a_gymnasium_environment():
    env = Bonus(MultiEnv(), bonus=3)
    assert env.reset(seed=1)[1]["bonus"] == 3
    copied = pickle.loads(pickle.dumps(env))
    assert type(copied) is Bonus
    actions = samples(env, "01")
    assert_same(copied.step(actions)[0], env.step(actions)[0])
    with pytest.raises(ConfigError, match="without a subclass, a ParallelEnv"):
        Bonus(SmallRace(), bonus=3)


def test_other_objects_and_environments_of_one_agent_are_refused():
    with pytest.raises(ConfigError, match=r"env is 3, expected a gymnasium\.Env"):
        MonoAgentWrapperAdapter(3, wrapper_factories={})
    with pytest.raises(ConfigError, match="Dict space by agent"):
        MonoAgentWrapperAdapter(gym.make("CartPole-v1"), wrapper_factories={})


def test_steps_match_the_reference():
    theirs = import_reference("wrappers").MonoAgentWrapperAdapter(
        MultiEnv(),
        wrapper_factories={
            "0": lambda env: wrap_as_reference(env, "simple"),
            "1": lambda env: wrap_as_reference(env, "flattened_discrete"),
        },
    )
    ours = MonoAgentWrapperAdapter(MultiEnv(), wrapper_factories={"0": simple, "1": discrete})
    first, second = ours.reset(seed=1), theirs.reset(seed=1)
    for _ in range(3):
        del second[0]["1"]["kart_type"]
        assert_same(first[0], second[0])
        assert first[1:] == second[1:]
        actions = samples(ours, "01")
        first, second = ours.step(actions), theirs.step(actions)
        first[-1].pop("truncated")


@pytest.mark.parametrize("name", ["second", "1", 1])
def test_agents_can_be_named_in_three_ways(form, name):
    make, agents = form
    name = agents[1] if name == "second" else name
    env = MonoAgentWrapperAdapter(make(), wrapper_factories={name: discrete})
    assert isinstance(space_of(env, agents[1])[1], spaces.Discrete)
    assert isinstance(space_of(env, agents[0])[1], spaces.Dict)


@pytest.mark.parametrize("name", ["kart_7", 2, None, True])
def test_an_unknown_agent_is_refused_and_the_error_lists_the_known_ones(form, name):
    make, agents = form
    with pytest.raises(ConfigError, match=f"unknown agent .*{agents[0]}, {agents[1]}"):
        MonoAgentWrapperAdapter(make(), wrapper_factories={name: simple})


def test_an_agent_that_is_named_twice_is_refused(form):
    make, agents = form
    with pytest.raises(ConfigError, match="named twice"):
        MonoAgentWrapperAdapter(make(), wrapper_factories={agents[0]: simple, 0: discrete})


def test_views_can_be_given_by_name_and_options(form):
    make, agents = form
    env = MonoAgentWrapperAdapter(make(), {1: ("simple", {"state_items": 2}), 0: "flattened"})
    same = MonoAgentWrapperAdapter(make(), {1: two_items, 0: lambda env: wrap(env, "flattened")})
    observations, expected = (each.reset(seed=1)[0] for each in (env, same))
    assert_same(observations, expected)
    assert observations[agents[1]]["items_position"].shape == (2, 3)
    for agent in agents:
        assert space_of(env, agent) == space_of(same, agent)


def test_factories_that_are_not_a_mapping_are_refused():
    with pytest.raises(ConfigError, match="expected a mapping from agents to views"):
        MonoAgentWrapperAdapter(SmallRace(), wrapper_factories=[simple])


def test_spaces_of_an_unknown_agent_are_refused():
    env = MonoAgentWrapperAdapter(race_v0.parallel_env(num_kart=2), wrapper_factories={})
    for of in (env, env.unwrapped):
        for space in (of.observation_space, of.action_space):
            with pytest.raises(ConfigError, match=r"unknown agent 'kart_9'.*Known: kart_0, kart_1"):
                space("kart_9")


def test_originals_are_copies_that_wrappers_cannot_change():
    env = MonoAgentWrapperAdapter(MultiEnv(), wrapper_factories={0: Wiper}, keep_original=True)
    observations, _ = env.reset(seed=1)
    for _ in range(2):
        assert observations in env.observation_space
        assert not observations["0"]["velocity"].any()
        assert observations["original/0"]["velocity"].all()
        observations = env.step(samples(env, "01"))[0]


def test_agents_that_have_left_are_skipped(form):
    make, agents = form
    env = MonoAgentWrapperAdapter(make(ends=(1, 3)), wrapper_factories={0: discrete, 1: simple})
    env.reset(seed=1)
    env.step(samples(env, agents))
    assert set(env.step(samples(env, agents[1:]))[0]) == {agents[1]}
    assert set(env.step(samples(env, agents))[0]) == {agents[1]}


def test_a_truncated_agent_leaves_the_parallel_adapter_and_its_kart_coasts():
    limits = {0: lambda env: TimeLimit(env, 1), 1: lambda env: TimeLimit(env, 2)}
    env = MonoAgentWrapperAdapter(SmallRace(), limits)
    env.reset(seed=1)
    assert env.step(samples(env, env.agents))[3] == {"kart_0": True, "kart_1": False}
    assert env.agents == ["kart_1"]
    assert set(env.step(samples(env, env.agents))[0]) == {"kart_1"}
    assert env.unwrapped.last_actions["kart_0"]["acceleration"].tolist() == [0.0]
    assert env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_truncating_all_agents_ends_the_gym_episode():
    env = MonoAgentWrapperAdapter(
        MultiEnv(), wrapper_factories={n: lambda env: TimeLimit(env, 2) for n in range(2)}
    )
    env.reset(seed=1)
    assert env.step(samples(env, "01"))[2:4] == (False, False)
    *_, terminated, truncated, info = env.step(samples(env, "01"))
    assert (terminated, truncated) == (False, True)
    assert info["truncated"] == {"0": True, "1": True}


@pytest.mark.parametrize("make", [race_v0.parallel_env, STKRaceMultiEnv])
def test_wrappers_get_the_step_size_of_the_race_as_in_a_view(make):
    seen = []

    class Spy(gym.Wrapper):
        def reset(self, *, seed=None, options=None):
            seen.append(options)
            return super().reset(seed=seed, options=options)

    race = make(num_kart=1, track="lighthouse", step_size=0.05)
    env = MonoAgentWrapperAdapter(race, wrapper_factories={0: Spy})
    env.reset(seed=1)
    env.reset(options={"step_size": 0.2})
    env.close()
    assert seen == [{"step_size": 0.05}, {"step_size": 0.2}]


def test_the_parallel_adapter_passes_pettingzoos_test():
    env = MonoAgentWrapperAdapter(
        SmallRace((20, 30, 40)),
        wrapper_factories={
            0: discrete,
            1: lambda env: TimeLimit(discrete(env), 10),
            2: discrete,
        },
    )
    parallel_api_test(env, num_cycles=100)


@pytest.fixture
def race():
    env = race_v0.parallel_env(num_kart=3, track="lighthouse")
    yield env
    env.close()


@pytest.mark.slow
def test_an_adapted_race_equals_one_with_views(race):
    with race_v0.parallel_env(
        num_kart=3, track="lighthouse", view={0: "simple", 1: "flattened_discrete"}
    ) as viewed:
        adapted = MonoAgentWrapperAdapter(race, wrapper_factories={0: simple, 1: discrete})
        assert_same(adapted.reset(seed=3)[0], viewed.reset(seed=3)[0])
        for agent in viewed.agents:
            viewed.action_space(agent).seed(1)
        for _ in range(30):
            actions = {agent: viewed.action_space(agent).sample() for agent in viewed.agents}
            ours, theirs = adapted.step(actions), viewed.step(actions)
            assert_same(ours[0], theirs[0])
            assert ours[1:4] == theirs[1:4]


@pytest.mark.parametrize("method", ["save_state", "restore_state", "clone", "lookahead", "follow"])
def test_a_state_or_clone_without_the_wrappers_is_refused(method):
    env = MonoAgentWrapperAdapter(SmallRace(), {"kart_0": Counter})
    with pytest.raises(ConfigError, match="make the race with view=wrapper_factories"):
        getattr(env, method)(*([env] if method in ("restore_state", "follow") else []))
