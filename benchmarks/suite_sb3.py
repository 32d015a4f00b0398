"""The library baseline of the suite: PPO of Stable-Baselines3 on the races of a task.

As in the guide to Stable-Baselines3, the first half of the kart-steps starts anywhere on the track,
in short races; the second half starts on the grid. The agent acts by its most likely choices, and
without the action filter of the reference algorithms.
"""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CheckpointCallback

from stkzoo.agents.training.ppo.network import FIRST_BIASES
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv, save_agent
from stkzoo.suite import find_task

#: Name of the algorithm in entries, and the task that it learns.
ALGORITHM, TASK = "sb3", "versus"
_RACES = 16
_SHORT_RACE = 250  # steps
#: Arguments as those of the reference algorithms; the others are the library's defaults.
_ARGUMENTS = {"n_steps": 128, "batch_size": 512, "n_epochs": 4, "gamma": 0.995, "gae_lambda": 0.9}
_HIDDEN = [256, 128]
_KEEP_EVERY = 50_000  # kart-steps


def train(folder: Path, kart_steps: int, seed: int) -> None:
    """Trains a run, or continues it from its last checkpoint, and writes its agent.

    Args:
        folder: folder of the run.
        kart_steps: number of kart-steps to learn from.
        seed: seed of the run.
    """
    torch.set_num_threads(1)  # the network is small: leave the cores to the races
    keep = CheckpointCallback(_KEEP_EVERY // _RACES, str(folder / "checkpoints"), "")
    files = [*(folder / "checkpoints").glob("*.zip")]
    newest = max(files, key=lambda file: int(file.name.split("_")[1]), default=None)
    model = PPO.load(newest, device="cpu") if newest else None
    stages = {kart_steps // 2: {"start": "random", "max_cycles": _SHORT_RACE}, kart_steps: {}}
    for until, start in stages.items():
        options = {**find_task(TASK).options(), **start}
        with closing(RaceVecEnv(_RACES, num_starts=20, **options)) as races:
            model = model or _new_model(races, seed)
            model.set_env(races)
            races.seed(seed + model.num_timesteps)
            left = until - model.num_timesteps
            if left > 0:
                model.learn(left, keep, reset_num_timesteps=False, progress_bar=True)
    view, name = find_task(TASK).view, f"{ALGORITHM}_{TASK}_{seed}"
    save_agent(model, folder / "agent", view=view, name=name)


def _new_model(races: RaceVecEnv, seed: int) -> PPO:
    model = PPO(
        "MlpPolicy",
        races,
        rollout_buffer_class=ActiveRolloutBuffer,
        policy_kwargs={"net_arch": _HIDDEN},
        seed=seed,
        device="cpu",
        **_ARGUMENTS,
    )
    with torch.no_grad():  # begin with the accelerator, and without the rescue button
        for choice, bias in FIRST_BIASES.items():
            model.policy.action_net.bias[choice] += bias
    return model
