"""Tasks with flat spaces drive the same races as the original tasks."""

import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo.test import parallel_api_test

from stkzoo.errors import ActionError, ConfigError
from stkzoo.race_v0 import parallel_env
from stkzoo.suite import FlatTask, find_task
from stkzoo.suite.flat import ACTION_FORMS, ALL_CHOICES, FEW_CHOICES
from stkzoo.wrappers.racing import BRAKE, CHOICES, RESCUE, STEERS


@pytest.mark.parametrize("name", ["solo-1", "talk-2v2"])
@pytest.mark.parametrize("actions", ACTION_FORMS)
def test_a_flat_task_is_a_parallel_environment_with_vectors(name, actions):
    env = FlatTask(find_task(name).make(max_cycles=20), actions=actions)
    parallel_api_test(env, num_cycles=25)
    assert isinstance(env.observation_space("kart_0"), spaces.Box)
    assert isinstance(env.action_space("kart_0"), spaces.Discrete | spaces.Box)
    env.close()


def test_the_tables_have_valid_and_different_choices():
    for table in (FEW_CHOICES, ALL_CHOICES):
        assert (table >= 0).all()
        assert (table < CHOICES).all()
        assert len(np.unique(table, axis=0)) == len(table)
    assert len(ALL_CHOICES) == np.prod(CHOICES)
    assert not (FEW_CHOICES[:, 1] == RESCUE).any()


def test_the_small_action_table_is_symmetric():
    mirrored = FEW_CHOICES.copy()
    mirrored[:, 0] = len(STEERS) - 1 - mirrored[:, 0]
    assert {tuple(row) for row in mirrored} == {tuple(row) for row in FEW_CHOICES}


@pytest.mark.parametrize(
    ("actions", "action", "choices"),
    [
        ("few", 3, [10, 0, 0, 0, 0]),
        ("few", 17, [20, BRAKE, 0, 0, 0]),
        ("all", 671, [20, 3, 1, 1, 1]),
        ("continuous", np.array([0.3, -0.4, 0.4, 0.6, 1.0], np.float32), [15, 0, 0, 1, 1]),
        ("continuous", np.array([-1, -0.6, 1, 0, 0], np.float32), [0, BRAKE, 1, 0, 0]),
    ],
)
def test_an_action_drives_like_its_choices(actions, action, choices):
    flat = FlatTask(find_task("solo-1").make(), actions=actions)
    own = find_task("solo-1").make()
    flat.reset(seed=2)
    own.reset(seed=2)
    for _ in range(25):
        seen, rewards, *_ = flat.step({"kart_0": action})
        expected, own_rewards, *_ = own.step({"kart_0": np.array(choices)})
        assert (seen["kart_0"] == expected["kart_0"]).all()
        assert rewards == own_rewards
    flat.close()
    own.close()


@pytest.mark.parametrize(
    ("actions", "action", "silent"),
    [
        ("few", 3 * 8 + 5, 3 * 8),
        ("continuous", np.eye(13, dtype=np.float32)[10], np.zeros(13, np.float32)),
    ],
)
def test_a_word_is_part_of_the_action_and_of_the_teammates_observation(actions, action, silent):
    env = FlatTask(find_task("talk-2v2").make(), actions=actions)
    env.reset(seed=1)
    for said, word in ((action, 5), (silent, 0)):
        seen, *_ = env.step(dict.fromkeys(env.agents, silent) | {"kart_0": said})
        heard, messages, _ = np.split(seen["kart_3"], [3, 27])
        assert heard.tolist() == [1, 0, 0]
        assert messages[:8].tolist() == np.eye(8)[word].tolist()
    env.close()


def test_invalid_arguments_and_actions_are_refused():
    with pytest.raises(ConfigError, match=r"unknown form of actions 'fewer'\. Did you mean 'few'"):
        FlatTask(find_task("solo-1").make(), actions="fewer")
    with pytest.raises(ConfigError, match="needs the actions of the view 'racing'"):
        FlatTask(parallel_env(view="box_discrete"))
    env = FlatTask(find_task("solo-1").make())
    env.reset(seed=1)
    with pytest.raises(ActionError, match=r"the action of 'kart_0' is 18, not in Discrete\(18\)"):
        env.step({"kart_0": 18})
    with pytest.raises(ActionError, match="no action for agent 'kart_0'"):
        env.step({})
    with pytest.raises(ActionError, match="dict by agent: kart_0; found None"):
        env.step(None)
    env.close()
