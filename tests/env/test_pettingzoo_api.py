"""PettingZoo's own tests pass; warnings that are not explained here are errors."""

from __future__ import annotations

import functools

import pettingzoo
import pytest
from pettingzoo.test import api_test, max_cycles_test, parallel_api_test, parallel_seed_test
from pettingzoo.test.state_test import state_test

from stkzoo import race_v0
from stkzoo.views import VIEWS
from tests.support.views import each_view, each_view_and_a_walked_one, marked

# PettingZoo's tests prefer arrays, but these Dict spaces have parts of several kinds.
NOT_AN_ARRAY = "ignore:Observation is not a NumPy array:UserWarning"
DICT_OBSERVATIONS = "ignore:Observation space for each agent probably should be:UserWarning"
DICT_ACTIONS = "ignore:Action space for each agent probably should be:UserWarning"
# Distances and times have no natural bounds.
UNBOUNDED = "ignore:Agent's (minimum|maximum) observation space value is:UserWarning"
# The state contains distances and times, which have no natural bounds.
UNBOUNDED_STATE = "ignore:Environment's (minimum|maximum) state space value is:UserWarning"

make = functools.partial(race_v0.parallel_env, num_kart=3, track="olivermath")
make_aec = functools.partial(race_v0.env, num_kart=3, track="olivermath")


@pytest.mark.slow
@each_view_and_a_walked_one
def test_parallel_api(view):
    with make(view=view) as env:
        parallel_api_test(env, num_cycles=200)


@pytest.mark.slow
@each_view
def test_parallel_seeds(view):
    parallel_seed_test(functools.partial(make, view=view, max_cycles=60), num_cycles=100)


@pytest.mark.slow
@pytest.mark.filterwarnings(NOT_AN_ARRAY, DICT_OBSERVATIONS, DICT_ACTIONS, UNBOUNDED)
@pytest.mark.parametrize(
    ("view", "factory"),
    [
        *marked([(view, race_v0.env) for view in VIEWS], [("simple", race_v0.env)]),
        ("full", race_v0.raw_env),
    ],
)
def test_aec_api(view, factory):
    env = factory(num_kart=3, track="olivermath", view=view, max_cycles=100)
    api_test(env, num_cycles=120)
    env.close()


def test_max_cycles_applies_to_both_apis():
    max_cycles_test(race_v0)


@pytest.mark.filterwarnings(UNBOUNDED_STATE)
def test_both_apis_have_a_state():
    with make() as parallel:
        aec = make_aec()
        state_test(aec, parallel)
        aec.close()


def test_an_aec_env_drives_the_same_race():
    with make(view="simple", max_cycles=30) as parallel:
        observations, _ = parallel.reset(seed=5)
        actions = {a: parallel.action_space(a).sample() for a in parallel.agents}
        while parallel.agents:
            observations, *_ = parallel.step(actions)
    aec = make_aec(view="simple", max_cycles=30)
    aec.reset(seed=5)
    last = {}
    for agent in aec.agent_iter():
        observation, _, terminated, truncated, _ = aec.last()
        last[agent] = observation
        aec.step(None if terminated or truncated else actions[agent])
    aec.close()
    for agent, observation in observations.items():
        assert (observation["velocity"] == last[agent]["velocity"]).all()


@pytest.mark.skipif(not hasattr(pettingzoo, "make"), reason="needs PettingZoo 1.27")
@pytest.mark.parametrize(
    ("api", "env_id"), [("parallel", "supertuxkart/race-v0"), ("aec", "supertuxkart/race_v0")]
)
def test_the_registry_makes_both_apis(api, env_id):
    env = pettingzoo.make(api, env_id, num_kart=2, max_cycles=3)
    env.reset(seed=1)
    assert isinstance(env, pettingzoo.ParallelEnv if api == "parallel" else pettingzoo.AECEnv)
    assert env.possible_agents == ["kart_0", "kart_1"]
    assert env.unwrapped.metadata["name"] == "race_v0"
    env.close()


@pytest.mark.parametrize("factory", [race_v0.parallel_env, race_v0.env])
def test_metadata_has_the_keys_that_pettingzoo_requires(factory):
    env = factory(num_kart=1)
    assert env.metadata["name"] == "race_v0"
    assert env.metadata["is_parallelizable"] is True
    assert "rgb_array" in env.metadata["render_modes"]
    assert str(env) == "race_v0"
    env.close()
