"""The plans of *ace* without its networks."""

import numpy as np

from benchmarks import ace_plans
from stkzoo.agents.planning.driver import CHOICES, INPUT_SIZE, PolicyInput, likeliest
from stkzoo.agents.pretrained import ace
from stkzoo.drivers.code import read_module


def test_the_networks_have_no_effect():
    random = np.random.default_rng(0)
    inputs = random.normal(size=(200, INPUT_SIZE)).astype(np.float32)
    prior = random.normal(size=(200, sum(CHOICES))).astype(np.float32)
    chosen = ace_plans._plans().best(PolicyInput(inputs, prior))
    np.testing.assert_array_equal(chosen, likeliest(prior))


def test_it_is_an_agent_with_the_plans_of_ace():
    code = read_module(ace_plans)
    assert code.name == "ace without networks"
    assert ace_plans.create_state is ace.create_state
