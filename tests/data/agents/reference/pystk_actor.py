"""An agent for pystk2-gymnasium that does not mention the other package."""

import numpy as np
from pystk2_gymnasium import ActionObservationWrapper
from pystk2_gymnasium.definitions import AgentSpec
from pystk2_gymnasium.stk_wrappers import ConstantSizedObservations, PolarObservations

env_name = "supertuxkart/full-v0"
player_name = "Reference"


class Shy(ActionObservationWrapper):
    def observation(self, obs):
        return obs

    def action(self, action):
        return {**action, "nitro": 0}


def get_wrappers():
    return [lambda env: PolarObservations(ConstantSizedObservations(env)), Shy]


def get_actor(module_dir, observation_space, action_space):
    spec = AgentSpec(name="unused")
    assert spec.use_ai is False

    def actor(state, obs):
        action = action_space.sample()
        action.update(brake=0, drift=0, fire=0, rescue=0)
        action["acceleration"] = np.array([1.0], np.float32)
        action["steer"] = np.clip(2.5 * obs["paths_end"][3][:1], -1, 1).astype(np.float32)
        return action

    return actor
