"""BenchMARL's algorithms on the tasks of the suite. Most tests need BenchMARL."""

import importlib.util
import pickle
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from stkzoo.errors import ConfigError
from stkzoo.race import run_race
from stkzoo.suite import TASKS
from stkzoo.suite.flat import ALL_CHOICES, FEW_CHOICES

HAS_LIBRARY = importlib.util.find_spec("benchmarl") is not None
needs_library = pytest.mark.skipif(not HAS_LIBRARY, reason="extra benchmarl")
#: TorchRL and BenchMARL emit warnings about their own versions and names.
pytestmark = pytest.mark.filterwarnings("ignore")

DISCRETE = ("ippo", "mappo", "isac", "masac", "iql", "vdn", "qmix")
CONTINUOUS = ("iddpg", "maddpg", "ippo", "mappo", "isac", "masac")


def make_experiment(algorithm, folder, task="TEAM_2V2", is_continuous=False, **options):
    """Makes an experiment of 120 short frames."""
    from benchmarl.algorithms import algorithm_config_registry
    from benchmarl.experiment import Experiment, ExperimentConfig
    from benchmarl.models.mlp import MlpConfig

    from stkzoo.suite.benchmarl import SuiteTask

    config = ExperimentConfig.get_from_yaml()
    config.prefer_continuous_actions = is_continuous
    config.max_n_frames = 120
    for name in ("on", "off"):
        setattr(config, f"{name}_policy_collected_frames_per_batch", 60)
        setattr(config, f"{name}_policy_n_envs_per_worker", 2)
    config.on_policy_minibatch_size, config.on_policy_n_minibatch_iters = 30, 1
    config.off_policy_n_optimizer_steps, config.off_policy_memory_size = 2, 100
    config.off_policy_train_batch_size = 32
    config.evaluation_episodes, config.evaluation_interval = 1, 60
    config.loggers, config.save_folder = ["csv"], str(folder)
    return Experiment(
        task=SuiteTask[task].get_task({"race": {"max_cycles": 20}, **options}),
        algorithm_config=algorithm_config_registry[algorithm].get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        seed=1,
        config=config,
    )


@pytest.mark.skipif(HAS_LIBRARY, reason="BenchMARL is installed")
def test_a_missing_library_is_named_with_the_command_that_installs_it():
    with pytest.raises(ConfigError, match=r"needs benchmarl, which is not installed: .*install"):
        import stkzoo.suite.benchmarl  # noqa: F401


def test_the_suite_does_not_import_the_library():
    code = "import stkzoo.suite, sys; print('torchrl' in sys.modules, 'benchmarl' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "False"]


@needs_library
def test_every_task_of_the_suite_is_a_task_of_benchmarl():
    from stkzoo.suite.benchmarl import SuiteTask

    assert [member.get_task().task for member in SuiteTask] == list(TASKS.values())
    task = SuiteTask.TALK_2V2.get_task({"race": {"max_cycles": 9}})
    assert pickle.loads(pickle.dumps(task)) == task


@needs_library
def test_the_common_reward_counts_only_agents_that_still_race():
    import torch
    from tensordict import TensorDict

    from stkzoo.suite.benchmarl import PresentReward

    batch = TensorDict(
        {
            ("team_0", "mask"): torch.tensor([[True, True], [False, True], [False, False]]),
            ("next", "team_0", "reward"): torch.tensor([[1.0, 1], [0, 3], [0, 0]])[..., None],
        },
        batch_size=[3],
    )
    assert ("next", "reward") not in PresentReward("team_0")(batch.clone()).keys(True)
    batch["next", "reward"] = batch["next", "team_0", "reward"].mean(-2)
    assert batch["next", "reward"].flatten().tolist() == [1, 1.5, 0]
    assert PresentReward("team_0")(batch)["next", "reward"].flatten().tolist() == [1, 3, 0]


@needs_library
def test_unknown_options_are_refused():
    from stkzoo.suite.benchmarl import SuiteTask

    with pytest.raises(ConfigError, match=r"unknown option of a task 'action'\. Did you mean"):
        SuiteTask.VERSUS.get_task({"action": "all"})
    with pytest.raises(ConfigError, match="unknown form of discrete actions 'continuous'"):
        SuiteTask.VERSUS.get_task({"actions": "continuous"})


@pytest.mark.slow
@needs_library
@pytest.mark.parametrize(
    ("algorithm", "is_continuous"),
    [*((name, False) for name in DISCRETE), *((name, True) for name in CONTINUOUS)],
)
def test_an_algorithm_learns_in_a_task(algorithm, is_continuous, tmp_path):
    experiment = make_experiment(algorithm, tmp_path, is_continuous=is_continuous)
    assert experiment.continuous_actions == is_continuous
    before = [value.detach().clone() for value in experiment.policy.parameters()]
    experiment.run()
    assert experiment.total_frames == 120
    after = list(experiment.policy.parameters())
    assert all((new != old).any() for new, old in zip(after, before, strict=True))
    assert list(tmp_path.rglob("*eval_reward_episode_reward_mean.csv"))


@needs_library
@pytest.mark.parametrize(
    ("algorithm", "actions", "table"),
    [("mappo", "few", FEW_CHOICES), ("qmix", "few", FEW_CHOICES), ("ippo", "all", ALL_CHOICES)],
)
def test_a_written_agent_acts_as_the_policy_does(algorithm, actions, table, tmp_path):
    import torch
    from tensordict import TensorDict
    from torchrl.envs import ExplorationType, set_exploration_type

    from stkzoo.suite.benchmarl import save_agent

    experiment = make_experiment(algorithm, tmp_path, actions=actions)
    folder = save_agent(experiment, tmp_path / "agent", name="Saved", group="team_1")
    act = runpy.run_path(f"{folder}/pystk_actor.py")["get_actor"](Path(folder), None, None)
    rows = torch.as_tensor(np.random.default_rng(1).uniform(-1, 1, (20, 2, 165))).float()
    batch = TensorDict(
        {(group, "observation"): rows for group in experiment.group_map}, batch_size=[20]
    )
    with set_exploration_type(ExplorationType.DETERMINISTIC), torch.no_grad():
        expected = table[experiment.policy(batch)["team_1", "action"].numpy()]
    found = [[act(None, row.numpy()) for row in pair] for pair in rows]
    assert (np.array(found) == expected).all()
    assert len(np.unique(expected.reshape(40, 5), axis=0)) > 1
    experiment.close()


@needs_library
def test_a_written_agent_races(tmp_path):
    from stkzoo.suite.benchmarl import save_agent

    experiment = make_experiment("ippo", tmp_path, "SOLO_1")
    folder = save_agent(experiment, tmp_path / "agent", name="Saved")
    result = run_race([folder, "ai"], track="lighthouse", seed=1, max_steps=20)
    assert {row.driver for row in result.agents} == {"Saved", "ai"}
    assert not any(row.errors for row in result.agents)
    with pytest.raises(ConfigError, match="unknown group 'team_0'"):
        save_agent(experiment, tmp_path / "other", name="Saved", group="team_0")
    experiment.close()


@needs_library
@pytest.mark.parametrize(
    ("task", "algorithm", "text"),
    [("SOLO_1", "iddpg", "only policies with discrete"), ("TALK_2V2", "ippo", "say no words")],
)
def test_unsupported_policies_are_not_written(task, algorithm, text, tmp_path):
    from stkzoo.suite.benchmarl import save_agent

    experiment = make_experiment(algorithm, tmp_path, task)
    with pytest.raises(ConfigError, match=text):
        save_agent(experiment, tmp_path / "agent", name="Saved")
    assert not (tmp_path / "agent").exists()
    experiment.close()
