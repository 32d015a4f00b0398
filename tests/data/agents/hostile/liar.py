"""Reports an invalid time in each reply."""

import itertools

from stkzoo.drivers import process

LIES = itertools.cycle([float("nan"), float("inf"), -1e9, "soon"])
answer = process._decide
process._decide = lambda *arguments: {**answer(*arguments), "seconds": next(LIES)}


def get_actor(module_dir, observation_space, action_space):
    return lambda state, observation: action_space.sample()
