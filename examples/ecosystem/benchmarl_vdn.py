"""BenchMARL: VDN in the suite's task team-2v2, whose teammates learn from the sum of their values.

python examples/ecosystem/benchmarl_vdn.py
python examples/ecosystem/benchmarl_vdn.py --frames 120000 --max-cycles 1500 --output my_agent

The agent that it writes needs only numpy:
stkzoo suite evaluate team-2v2 my_agent/ --class learned
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import torch
from benchmarl.algorithms import VdnConfig
from benchmarl.environments.pettingzoo.common import PettingZooClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from gymnasium import spaces
from pettingzoo.utils import BaseParallelWrapper
from torchrl.envs import PettingZooWrapper, Transform

from stkzoo.suite import find_task
from stkzoo.wrappers.racing import BRAKE, STEERS

TASK = find_task("team-2v2")
#: Each team is a group with a policy of its own.
GROUPS = {f"team_{n}": [f"kart_{kart}" for kart in team] for n, team in enumerate(TASK.teams)}

_STEERING = [len(STEERS) // 2 + offset for offset in (-10, -6, -3, 0, 3, 6, 10)]
#: Choices of the view ``racing`` for each action: steering, pedal, drift, nitro, fire.
CHOICES = np.array(
    [(steer, 0, 0, 0, 0) for steer in _STEERING]
    + [(steer, 0, 1, 0, 0) for steer in (_STEERING[i] for i in (0, 1, 5, 6))]
    + [(steer, 0, 0, 1, 0) for steer in _STEERING[2:5]]
    + [(_STEERING[3], 0, 0, 0, 1)]
    + [(steer, BRAKE, 0, 0, 0) for steer in _STEERING[::3]]
)

ACTOR = '''"""A policy of BenchMARL, evaluated with numpy."""

import numpy as np

env_name = "supertuxkart/racing-v0"
player_name = "VDN"
CHOICES = np.array({choices})


def get_actor(module_dir, observation_space, action_space):
    data = np.load(module_dir / "policy.npz")
    count = len(data.files) // 2
    *hidden, last = [(data[f"weight{{n}}"], data[f"bias{{n}}"]) for n in range(count)]

    def act(state, observation):
        values = observation
        for weight, bias in hidden:
            values = np.tanh(weight @ values + bias)
        return CHOICES[(last[0] @ values + last[1]).argmax()]

    return act
'''


class OneNumber(BaseParallelWrapper):
    """Makes an action one number, because BenchMARL's actions have no parts."""

    def action_space(self, agent: str) -> spaces.Discrete:
        return spaces.Discrete(len(CHOICES))

    def step(self, actions: dict[str, int]) -> tuple:
        return super().step({agent: CHOICES[number] for agent, number in actions.items()})

    def state(self) -> np.ndarray:
        """Returns the state of the race with values of similar magnitudes."""
        state = super().state()
        return np.sign(state) * np.log1p(np.abs(state))


class PresentReward(Transform):
    """Makes a team's reward the mean over its karts that are still racing.

    BenchMARL takes the mean over all karts, so the reward would halve when the first one finishes.
    """

    def __init__(self, group: str) -> None:
        super().__init__()
        self._group = group

    def forward(self, tensordict):
        mask = tensordict[self._group, "mask"].unsqueeze(-1)
        rewards = tensordict["next", self._group, "reward"] * mask
        tensordict["next", "reward"] = rewards.sum(-2) / mask.sum(-2).clamp(min=1)
        return tensordict


class TeamRace(PettingZooClass):
    """The task for BenchMARL."""

    def get_env_fun(self, num_envs, continuous_actions, seed, device):
        return lambda: PettingZooWrapper(
            OneNumber(TASK.make(**self.config)),
            group_map=GROUPS,
            use_mask=True,
            return_state=True,
            done_on_any=False,
            categorical_actions=True,
            seed=seed,
            device=device,
        )

    def supports_continuous_actions(self) -> bool:
        return False

    def supports_discrete_actions(self) -> bool:
        return True

    def has_render(self, env) -> bool:
        return False

    def get_replay_buffer_transforms(self, env, group: str) -> list[Transform]:
        return [PresentReward(group)]


def train(frames: int, max_cycles: int, folder: str) -> Experiment:
    """Trains two teams of two, and evaluates them once."""
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
    config.save_folder = folder
    experiment = Experiment(
        task=TeamRace("team-2v2", {"max_cycles": max_cycles}),
        algorithm_config=VdnConfig.get_from_yaml(),
        model_config=MlpConfig.get_from_yaml(),
        seed=0,
        config=config,
    )
    experiment.run()
    return experiment


def save_agent(experiment: Experiment, folder: Path) -> None:
    """Writes the policy of the first team as an agent."""
    network = experiment.algorithm.get_policy_for_loss(next(iter(GROUPS)))[0]
    layers = network.mlp.params
    arrays = {}
    for number, key in enumerate(sorted(layers.keys(), key=int)):
        for part in ("weight", "bias"):
            arrays[f"{part}{number}"] = layers[key, part].detach().cpu().numpy()
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "policy.npz", **arrays)
    (folder / "pystk_actor.py").write_text(ACTOR.format(choices=CHOICES.tolist()))


def main() -> None:
    parser = argparse.ArgumentParser(description="Trains two teams with VDN.")
    parser.add_argument("--frames", type=int, default=400, help="steps of races, with all karts")
    parser.add_argument("--max-cycles", type=int, default=50, help="longest race [steps]")
    parser.add_argument("--output", type=Path, help="folder of the agent to write")
    options = parser.parse_args()
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    with tempfile.TemporaryDirectory() as folder:
        experiment = train(options.frames, options.max_cycles, folder)
        save_agent(experiment, options.output or Path(folder, "agent"))
    print("steps:", experiment.total_frames, "mean return:", experiment.mean_return)


if __name__ == "__main__":
    main()
