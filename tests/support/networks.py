"""Small networks for the view ``racing``, in the format of self-play, for tests."""

import numpy as np

from stkzoo.agents.pretrained import action_filter
from stkzoo.wrappers.racing import CHOICES, STEERS

__all__ = ["small_network"]


def small_network(likes=(), seed=0, *, steers=0, inputs=action_filter.INPUT_SIZE):
    """Returns the weights of a network that prefers some choices, with random noise.

    Args:
        likes: choices whose logits are raised by 50.
        seed: seed of the random weights.
        steers: -1 or 1 to prefer steering to that side; 0 for no preference.
        inputs: size of the input.
    """
    chance = np.random.default_rng(seed)
    sizes = (inputs, 8, 8)
    weights = {"drift_hold": np.ones(1, np.float32), "value_net.bias": np.zeros(1, np.float32)}
    for layer, name in enumerate(["policy_net.0", "policy_net.2"]):
        shape = sizes[layer + 1], sizes[layer]
        weights[f"mlp_extractor.{name}.weight"] = chance.normal(0, 0.1, shape).astype(np.float32)
        weights[f"mlp_extractor.{name}.bias"] = np.zeros(shape[0], np.float32)
    weights["action_net.weight"] = chance.normal(0, 0.3, (sum(CHOICES), 8)).astype(np.float32)
    weights["action_net.bias"] = np.zeros(sum(CHOICES), np.float32)
    weights["action_net.bias"][: len(STEERS)] = steers * 10.0 * np.arange(len(STEERS))
    weights["action_net.bias"][list(likes)] = 50.0
    return weights
