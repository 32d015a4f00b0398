"""BenchMARL's algorithms in the tasks of the suite. Without BenchMARL, most are skipped."""

import importlib.util
import pickle
import subprocess
import sys

import pytest

from stkzoo.errors import ConfigError
from stkzoo.suite import TASKS

HAS_LIBRARY = importlib.util.find_spec("benchmarl") is not None
needs_library = pytest.mark.skipif(not HAS_LIBRARY, reason="extra benchmarl")
#: TorchRL and BenchMARL warn about their own versions and names.
pytestmark = pytest.mark.filterwarnings("ignore")

DISCRETE = ("ippo", "mappo", "isac", "masac", "iql", "vdn", "qmix")
CONTINUOUS = ("iddpg", "maddpg", "ippo", "mappo", "isac", "masac")


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
def test_the_common_reward_counts_agents_that_race_only():
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
def test_mistakes_are_named():
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
    config.loggers, config.save_folder = ["csv"], str(tmp_path)
    experiment = Experiment(
        task=SuiteTask.TEAM_2V2.get_task({"race": {"max_cycles": 20}}),
        algorithm_config=algorithm_config_registry[algorithm].get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        seed=1,
        config=config,
    )
    assert experiment.continuous_actions == is_continuous
    before = [value.detach().clone() for value in experiment.policy.parameters()]
    experiment.run()
    assert experiment.total_frames == 120
    after = list(experiment.policy.parameters())
    assert all((new != old).any() for new, old in zip(after, before, strict=True))
    assert list(tmp_path.rglob("*eval_reward_episode_reward_mean.csv"))
