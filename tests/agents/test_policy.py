"""Policies over plans: the prior and the logits that a network adds."""

import numpy as np
import pytest

from stkzoo.agents.planning.driver import CHOICES, HEADS, INPUT_SIZE, PolicyInput
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


def test_learned_logits_are_added_to_the_prior():
    prior = np.zeros((1, sum(CHOICES)), np.float32)
    prior[0, FREE] = 2.0
    view = PolicyInput(np.zeros((1, INPUT_SIZE), np.float32), prior)
    learned = np.zeros(sum(CHOICES), np.float32)
    learned[BRAKE] = 3.0
    assert flat_policy().best(view)[0, 0] == FREE
    assert flat_policy(b2=learned).best(view)[0, 0] == BRAKE
