"""Ids of views that users register."""

import gymnasium as gym
import pytest

import stkzoo
from stkzoo.views import VIEWS

CELL = """
def own_view(env):
    return gym.wrappers.FilterObservation(env, ["{key}"])


class OwnView(gym.ObservationWrapper):
    def observation(self, observation):
        return observation
"""


@pytest.fixture(autouse=True)
def forget_own_view():
    yield
    VIEWS.pop("own", None)
    gym.registry.pop("supertuxkart/own-v0", None)


def run_cell(key="velocity"):
    """Runs a notebook cell and returns the names that it defines, new objects in each call."""
    names = {"gym": gym, "__name__": "__main__"}
    exec(CELL.format(key=key), names)
    return names


@pytest.mark.parametrize("name", ["own_view", "OwnView"])
def test_a_notebook_cell_that_registers_a_view_can_run_twice(name):
    for _ in range(2):
        stkzoo.register_view("own", run_cell()[name])


def test_an_anonymous_function_is_recognized_by_its_definition():
    stkzoo.register_view("own", own_lambda(3))
    stkzoo.register_view("own", again := own_lambda(4))
    assert VIEWS["own"] is again
    with pytest.raises(stkzoo.ConfigError, match="'own' exists already"):
        stkzoo.register_view("own", lambda env: env)


def own_lambda(items):
    return lambda env: stkzoo.ConstantSizedObservations(env, state_items=items)


def test_the_view_of_the_last_run_is_used():
    for key in ("velocity", "front"):
        stkzoo.register_view("own", run_cell(key)["own_view"])
    with gym.make("supertuxkart/own-v0", track="lighthouse", num_kart=1) as env:
        observation, _ = env.reset(seed=1)
        assert list(observation) == ["front"]


@pytest.mark.parametrize("other", [lambda env: env, run_cell()["OwnView"], VIEWS["simple"]])
def test_another_view_with_the_same_name_needs_replace(other):
    stkzoo.register_view("own", run_cell()["own_view"])
    with pytest.raises(stkzoo.ConfigError, match=r"'own' exists already.*replace=True"):
        stkzoo.register_view("own", other)
    stkzoo.register_view("own", other, replace=True)
    assert VIEWS["own"] is other


@pytest.mark.parametrize("name", ["simple", "camera"])
def test_a_view_of_stkzoo_cannot_be_replaced(name):
    with pytest.raises(stkzoo.ConfigError, match=f"{name!r} is stkzoo's own"):
        stkzoo.register_view(name, lambda env: env, replace=True)
