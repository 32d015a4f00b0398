"""Steers and talks by a checksum of all observations, so that any changed bit changes the race."""

import zlib

import numpy as np

env_name = "stkzoo-suite/talk-2v2-v1"


class Memory:
    checksum = 0


create_state = Memory


def get_actor(module_dir, observation_space, action_space):
    assert observation_space["messages"].shape[1] == action_space["message"].n == 8

    def actor(state, observation):
        for key in ("observation", "messages", "heard"):
            value = observation[key]
            assert value.dtype == observation_space[key].dtype
            state.checksum = zlib.crc32(value.tobytes(), state.checksum)
        steer = 7 + state.checksum % 7
        return {"action": np.array([steer, 0, 0, 0, 0]), "message": state.checksum // 7 % 8}

    return actor
