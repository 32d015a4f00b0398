"""Checks of arguments."""

import gymnasium as gym
import numpy as np
import pytest

import stkzoo
from stkzoo import race_v0
from stkzoo._checks import check_number, shortened
from stkzoo.errors import ConfigError
from stkzoo.race import RaceSettings, run_race


@pytest.mark.parametrize("value", [True, "1", None, float("nan"), 0, -1, float("inf"), 10**400])
def test_values_other_than_positive_numbers_are_refused(value):
    with pytest.raises(ConfigError, match=r"wait is .*, expected a number of seconds above 0"):
        check_number("wait", value, unit="seconds")


@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), "0"])
def test_a_number_out_of_its_bounds_is_refused(value):
    with pytest.raises(ConfigError, match=r"share is .*, expected a number from 0 to 1"):
        check_number("share", value, 0, 1)


class Broken:
    def __repr__(self):
        raise ValueError


@pytest.mark.parametrize(
    "value",
    [
        *(None, 1.5, "it's", b"x", [], (), {}, set(), (1,), [1, "a", (2, [None])]),
        *({"b": 1, "a": [b"x"]}, np.zeros(3), np.float32(1), {1}, range(3)),
    ],
    ids=repr,
)
def test_a_short_value_is_shown_as_its_repr(value):
    assert shortened(value) == repr(value)


def test_a_long_value_is_cut():
    assert shortened(["x"] * 100, 20) == "['x', 'x', 'x', '..."


def test_a_large_array_is_shown_as_its_shape_and_dtype():
    text = "an array of shape (7, 7, 7, 7) and dtype int8"
    assert shortened(np.zeros([7] * 4, np.int8)) == text


def test_a_value_whose_repr_fails_is_named():
    assert shortened([1, Broken()]) == "(list: its __repr__ failed)"


@pytest.mark.parametrize(
    ("make", "wrong", "meant"),
    [
        (race_v0.parallel_env, "numkart", "num_kart"),
        (lambda **options: gym.make("supertuxkart/simple-v0", **options), "lap", "laps"),
        (lambda **options: stkzoo.RaceVectorEnv(2, **options), "revers", "reverse"),
        (lambda **options: run_race(["ai"], **options), "max_step", "max_steps"),
        (stkzoo.AgentSpec, "rankstart", "rank_start"),
        (RaceSettings, "trak", "track"),
        (stkzoo.MonoAgentWrapperAdapter, "wraper_factories", "wrapper_factories"),
    ],
)
def test_an_unknown_keyword_is_reported_with_the_nearest_name(make, wrong, meant):
    with pytest.raises(ConfigError) as caught:
        make(**{wrong: 1})
    assert f"{wrong!r}. Did you mean {meant!r}?" in str(caught.value)
    assert "\n" not in str(caught.value)
