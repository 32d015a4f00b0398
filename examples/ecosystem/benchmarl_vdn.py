"""BenchMARL: a short VDN, whose teammates learn from the sum of their values.

python examples/ecosystem/benchmarl_vdn.py
"""

import tempfile

import torch
from benchmarl.algorithms import VdnConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig

from stkzoo.suite.benchmarl import SuiteTask


def main(frames: int = 400) -> None:
    """Trains two teams of two on short races, and evaluates them once."""
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    config = ExperimentConfig.get_from_yaml()
    config.prefer_continuous_actions = False
    config.max_n_frames = frames
    config.off_policy_n_envs_per_worker = 2
    config.off_policy_collected_frames_per_batch = 100
    config.off_policy_n_optimizer_steps = 10
    config.off_policy_train_batch_size = 64
    config.off_policy_memory_size = frames
    config.evaluation_interval = frames
    config.evaluation_episodes = 1
    config.loggers = []
    with tempfile.TemporaryDirectory() as folder:
        config.save_folder = folder
        experiment = Experiment(
            task=SuiteTask.TEAM_2V2.get_task({"race": {"max_cycles": 50}}),
            algorithm_config=VdnConfig.get_from_yaml(),
            model_config=MlpConfig.get_from_yaml(),
            seed=0,
            config=config,
        )
        experiment.run()
    print("steps:", experiment.total_frames, "mean return:", experiment.mean_return)


if __name__ == "__main__":
    main()
