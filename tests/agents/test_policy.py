"""Policies over plans: the prior and the logits that a network adds."""

import numpy as np

from stkzoo.agents.planning.driver import CHOICES, INPUT_SIZE, PolicyInput
from stkzoo.agents.planning.plans import BRAKE, FREE
from stkzoo.agents.pretrained.policy import RacingPolicy


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


def test_learned_logits_are_added_to_the_prior():
    prior = np.zeros((1, sum(CHOICES)), np.float32)
    prior[0, FREE] = 2.0
    view = PolicyInput(np.zeros((1, INPUT_SIZE), np.float32), prior)
    learned = np.zeros(sum(CHOICES), np.float32)
    learned[BRAKE] = 3.0
    assert flat_policy().best(view)[0, 0] == FREE
    assert flat_policy(b2=learned).best(view)[0, 0] == BRAKE
