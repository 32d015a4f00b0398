"""Ids of views that users register."""

from functools import partial

import gymnasium as gym
import pytest

import stkzoo
from stkzoo.views import VIEWS


def test_the_last_registered_view_of_a_name_is_used():
    try:
        for key in ("velocity", "front"):
            view = partial(gym.wrappers.FilterObservation, filter_keys=[key])
            stkzoo.register_view("own", view)
        with gym.make("supertuxkart/own-v0", track="lighthouse", num_kart=1) as env:
            observation, _ = env.reset(seed=1)
            assert list(observation) == ["front"]
    finally:
        del VIEWS["own"], gym.registry["supertuxkart/own-v0"]


@pytest.mark.parametrize("name", ["simple", "camera"])
def test_a_view_of_stkzoo_cannot_be_replaced(name):
    with pytest.raises(stkzoo.ConfigError, match=f"{name!r} is stkzoo's own"):
        stkzoo.register_view(name, lambda env: env)
