"""An agent with its own wrappers around stkzoo's view ``simple``; one of them keeps a state."""

import gymnasium as gym
import numpy as np

from stkzoo import ActionObservationWrapper

env_name = "supertuxkart/simple-v0"
player_name = "Wrapped"


class Angle(ActionObservationWrapper):
    """Reduces the observation to one angle and the action to the steering."""

    def __init__(self, env):
        super().__init__(env)
        self.observation_space = gym.spaces.Box(-4, 4, (1,))
        self.action_space = gym.spaces.Box(-1, 1, (1,))

    def observation(self, observation):
        return np.array([observation["paths_end"][3][0]], np.float32)

    def action(self, action):
        buttons = dict.fromkeys(("brake", "drift", "fire", "nitro", "rescue"), 0)
        return {"acceleration": np.ones(1, np.float32), "steer": action, **buttons}


def get_wrappers():
    return [Angle, lambda env: gym.wrappers.FrameStackObservation(env, 2)]


def get_actor(module_dir, observation_space, action_space):
    assert observation_space.shape == (2, 1)

    def actor(state, observation):
        now, before = observation[1], observation[0]
        return np.clip(2.5 * now + (now - before), -1, 1).astype(np.float32)

    return actor
