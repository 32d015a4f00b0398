"""Opponent pools, and valid opponents."""

from __future__ import annotations

import copy
import pickle
from collections import Counter

import numpy as np
import pytest

from stkzoo.drivers import OpponentPool
from stkzoo.errors import ConfigError


def straight(observation):
    """Drives at full throttle."""
    del observation
    return [1.0, 0.0]


class Still:
    """A policy with Stable-Baselines3's interface whose weights still change."""

    def __init__(self):
        self.weights = np.zeros(2)

    def predict(self, observation, deterministic=False):
        assert deterministic
        return np.tile(self.weights, (len(observation), 1)), None


def draws(pool, count=2000, seed=1, **options):
    random = np.random.default_rng(seed)
    return [pool.draw(random, **options).name for _ in range(count)]


def test_opponents_are_drawn_by_their_weights():
    pool = OpponentPool(["heuristic", "random"], weights=[1, 3])
    share = Counter(draws(pool))["random"] / 2000
    assert 0.7 < share < 0.8


def test_the_same_stream_draws_the_same_opponents():
    pool = OpponentPool(["heuristic", "random", "ai"])
    assert draws(pool, 50) == draws(pool, 50)
    assert draws(pool, 50) != draws(pool, 50, seed=2)


def test_a_pool_draws_added_opponents():
    pool = OpponentPool(["heuristic"])
    pool.add(straight, weight=1000)
    assert Counter(draws(pool, 100)).most_common(1)[0][0] == "straight"
    assert len(pool) == 2


def test_a_pool_draws_only_the_wanted_kind():
    pool = OpponentPool(["heuristic", "ai:3"])
    assert {*draws(pool, 50, is_game_ai=True)} == {"ai:3"}
    assert {*draws(pool, 50, is_game_ai=False)} == {"heuristic"}
    pool.weights["heuristic"] = 0
    with pytest.raises(ConfigError, match="no opponents at difficulty 3 besides the game's AI"):
        draws(pool, difficulty=3, is_game_ai=False)


def test_duplicate_names_are_numbered():
    pool = OpponentPool([straight, straight, "random"])
    pool.add(straight, name="random")
    assert list(pool.weights) == ["straight", "straight 2", "random", "random 2"]


def test_opponents_of_another_difficulty_are_left_out():
    pool = OpponentPool(["ai:0", "ai:3", "random"])
    assert {*draws(pool, 100, difficulty=3)} == {"ai:3", "random"}
    with pytest.raises(ConfigError, match=r"no opponents at difficulty 1; add\(\)"):
        draws(OpponentPool(["ai:0"]), 1, difficulty=1)


def test_an_empty_pool_says_what_to_do():
    with pytest.raises(ConfigError, match=r"no opponents; add\(\) one before the race"):
        draws(OpponentPool(), 1)


def test_a_pool_keeps_a_copy_of_a_policy():
    policy, pool = Still(), OpponentPool()
    pool.add(policy)
    policy.weights += 1
    kept = pool.draw(np.random.default_rng(0)).load(None).make_actor(None, None, 0)
    assert kept(np.zeros(3)).tolist() == [0, 0]


def test_a_pool_can_be_pickled_and_copied():
    pool = OpponentPool(["pretrained:ace", "ai:3", straight, Still()])
    for twin in (pickle.loads(pickle.dumps(pool)), copy.deepcopy(pool)):
        assert draws(twin, 20) == draws(pool, 20)


@pytest.mark.parametrize("wrong", [3, None, ["heuristic"], Still])
def test_invalid_opponents_are_refused(wrong):
    with pytest.raises(ConfigError, match="expected a"):
        OpponentPool().add(wrong)


def test_weights_are_checked():
    with pytest.raises(ConfigError, match="weight of an opponent is 0, expected a number above 0"):
        OpponentPool().add("ai", weight=0)
    with pytest.raises(ConfigError, match="1 weights for 2 opponents"):
        OpponentPool(["ai", "random"], weights=[1])


def test_a_mapping_gives_weights_by_name():
    pool = OpponentPool({"ai:3": 3, "heuristic": 1})
    assert pool.weights == {"ai:3": 3.0, "heuristic": 1.0}
    with pytest.raises(ConfigError, match="opponents is 'ai', expected a list"):
        OpponentPool("ai")


def test_weights_can_be_changed_and_are_checked():
    pool = OpponentPool(["ai", "random"])
    pool.weights["ai"] = 0
    assert {*draws(pool, 50)} == {"random"}
    pool.weights["random"] = -1
    with pytest.raises(ConfigError, match="weight of opponent 'random' is -1, expected a number"):
        draws(pool, 1)


def test_a_weight_of_no_opponent_and_a_missing_weight_are_refused():
    pool = OpponentPool(["ai", "random"])
    pool.weights["rando"] = 0
    with pytest.raises(ConfigError, match="has weights of ai, random, rando, expected ai, random"):
        draws(pool, 1)
    pool.weights = {"ai": 1.0}
    with pytest.raises(ConfigError, match="has weights of ai, expected ai, random"):
        draws(pool, 1)


@pytest.mark.parametrize(("view", "why"), [("racin", "mean 'racing'"), ("camera", "has pictures")])
def test_unsupported_views_are_refused(view, why):
    with pytest.raises(ConfigError, match=why):
        OpponentPool().add(straight, view=view)
