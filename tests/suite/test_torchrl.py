"""Races of the suite's tasks as batched TorchRL environments. These tests need TorchRL."""

import numpy as np
import pytest

from stkzoo.errors import ConfigError
from stkzoo.suite import FlatTask, find_task
from stkzoo.wrappers.racing import CHOICES

pytest.importorskip("torchrl", reason="extra benchmarl")
#: TorchRL emits warnings about its own names.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture
def races():
    """Returns a function that makes races of a task and closes them at the end."""
    from stkzoo.suite.torchrl import SuiteRaces, TaskOptions

    made = []

    def make(name, count=2, *, is_continuous=False, seed=1, **options):
        task, chosen = find_task(name), TaskOptions.of(options)
        made.append(SuiteRaces(task, count, is_continuous=is_continuous, options=chosen, seed=seed))
        return made[-1]

    yield make
    for env in made:
        env.close(raise_if_closed=False)


def drive(env, actions, steps=1):
    """Steps races without resets, with the same ``actions`` each time; returns all data."""
    import torch

    data = env.reset()
    found = []
    for _ in range(steps):
        for group in env.group_map:
            spec = env.full_action_spec[group, "action"]
            data[group, "action"] = torch.as_tensor(actions).expand(spec.shape).clone()
        data = env.step(data)["next"]
        found.append(data.clone())
    return found


def test_a_batch_without_races_is_refused(races):
    with pytest.raises(ConfigError, match="num_races is 0, expected a whole number of 1 or more"):
        races("solo-1", 0)


@pytest.mark.parametrize("is_continuous", [False, True])
@pytest.mark.parametrize("name", ["versus", "team-2v2", "talk-2v2"])
def test_races_follow_the_specs_of_torchrl(races, name, is_continuous):
    from torchrl.envs import check_env_specs

    env = races(name, is_continuous=is_continuous, race={"max_cycles": 12})
    check_env_specs(env)
    batch = env.rollout(30, break_when_any_done=False)
    assert batch["next", "done"].sum() == batch["next", "truncated"].sum() == 4
    assert env.reset()["state"].shape == (2, find_task(name).state_size)


def test_a_race_of_the_batch_equals_the_race_of_the_task(races):
    env, own = races("team-2v2", seed=4), FlatTask(find_task("team-2v2").make())
    seen, _ = own.reset(seed=5)
    first = env.reset()
    assert (first["team_0", "observation"][1, 1].numpy() == seen["kart_3"]).all()
    for step in drive(races("team-2v2", seed=4), 3, steps=30):
        seen, rewards, *_ = own.step(dict.fromkeys(own.agents, 3))
        state = own.state()
        assert (step["team_1", "observation"][1, 0].numpy() == seen["kart_1"]).all()
        assert step["team_1", "reward"][1].flatten().tolist() == pytest.approx(
            [rewards["kart_1"], rewards["kart_2"]], rel=1e-6
        )
        scaled = np.sign(state) * np.log1p(np.abs(state))
        assert step["state"][1].numpy() == pytest.approx(scaled, rel=1e-5)
    own.close()


def test_a_seed_determines_the_races(races):
    import torch

    def batch(seed):
        torch.manual_seed(0)
        env = races("solo-1", seed=seed, race={"max_cycles": 20})
        return env.rollout(30, break_when_any_done=False)

    one, same, other = batch(1), batch(1), batch(2)
    assert (one == same).all()
    assert not (one["karts", "observation"] == other["karts", "observation"]).all()
    assert (one[1]["karts", "observation"][0] == other[0]["karts", "observation"][0]).all()
    env = races("solo-1", seed=1)
    env.set_seed(2)
    assert (env.reset()["karts", "observation"] == other[:, 0]["karts", "observation"]).all()


def test_agents_that_left_are_masked_and_the_race_continues(races):
    """A kart that stands still leaves after a second; the others race on until the limit."""
    import torch

    ahead, coast = (np.ravel_multi_index((10, pedal, 0, 0, 0), CHOICES) for pedal in (0, 1))
    env = races("team-2v2", 1, actions="all", race={"max_cycles": 40, "end_when_stuck": 1.0})
    data = env.reset()
    steps = []
    for _ in range(40):
        data["team_0", "action"] = torch.tensor([[coast, ahead]])
        data["team_1", "action"] = torch.tensor([[ahead, ahead]])
        data = env.step(data)["next"]
        steps.append(data.clone())
    left = next(n for n, step in enumerate(steps) if not step["team_0", "mask"][0, 0])
    assert 5 < left < 30
    assert steps[left]["team_0", "terminated"][0].flatten().tolist() == [True, False]
    assert steps[left]["team_0", "observation"][0, 0].any()
    for step in steps[left + 1 : -1]:
        assert step["team_0", "mask"].tolist() == [[False, True]]
        assert step["team_0", "done"][0].flatten().tolist() == [True, False]
        assert not step["team_0", "observation"][0, 0].any()
        assert step["team_0", "reward"][0, 0] == 0
        assert not step["done"].any()
    last = steps[-1]
    assert last["done"].all()
    assert last["truncated"].all()
    assert not last["terminated"].any()


def test_only_races_that_ended_restart(races):
    import torch

    env = races("solo-1", 2)
    env.reset()
    data = drive(env, 3, steps=5)[-1]
    data["_reset"] = torch.tensor([[True], [False]])
    again = env.reset(data.clone())
    assert (again["karts", "observation"][1] == data["karts", "observation"][1]).all()
    assert (again["karts", "observation"][0] != data["karts", "observation"][0]).any()


def test_teams_are_groups_unless_one_group_is_requested(races):
    assert races("team-2v2", 1).group_map == {
        "team_0": ["kart_0", "kart_3"],
        "team_1": ["kart_1", "kart_2"],
    }
    one = {"karts": ["kart_0", "kart_1", "kart_2", "kart_3"]}
    assert races("team-2v2", 1, is_one_group=True).group_map == one
    assert races("solo-1", 1).group_map == {"karts": ["kart_0"]}
