import numpy as np


class Policy:
    """A linear policy. The last column of the weights is the bias."""

    def __init__(self, weights, observation_space, action_space):
        self.weights = weights
        self.low, self.high = action_space.low, action_space.high
        assert observation_space["continuous"].shape == (weights.shape[1] - 1,)

    def __call__(self, state, observation):
        action = self.weights[:, :-1] @ observation["continuous"] + self.weights[:, -1]
        return np.clip(action, self.low, self.high).astype(np.float32)
