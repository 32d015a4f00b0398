"""Allocates shared memory, which does not count as the process's own data."""

import mmap
import time


def get_actor(module_dir, observation_space, action_space):
    kept = []

    def actor(state, observation):
        block = mmap.mmap(-1, 300 << 20)
        for page in range(0, len(block), 4096):
            block[page] = 1
        kept.append(block)
        time.sleep(0.3)
        return action_space.sample()

    return actor
