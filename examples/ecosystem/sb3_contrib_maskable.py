"""sb3-contrib: MaskablePPO never presses nitro or fire without effect.

python examples/ecosystem/sb3_contrib_maskable.py
"""

from typing import Any

import numpy as np
import torch
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.utils import get_action_masks
from stable_baselines3.common.vec_env import VecEnvWrapper

from stkzoo.sb3 import RaceVecEnv


class Masks(VecEnvWrapper):
    """Provides the mask of the last observation in the form that MaskablePPO expects."""

    def __init__(self, venv: RaceVecEnv) -> None:
        super().__init__(venv, observation_space=venv.observation_space["observation"])
        self.masks = np.ones((venv.num_envs, venv.action_space.n), bool)

    def _seen(self, observations: Any) -> Any:
        self.masks = observations["action_mask"].astype(bool)
        self.masks[~self.masks.any(axis=1)] = True  # idle agents
        return observations["observation"]

    def reset(self) -> Any:
        return self._seen(self.venv.reset())

    def step_wait(self) -> Any:
        observations, rewards, dones, infos = self.venv.step_wait()
        for info in infos:
            if "terminal_observation" in info:
                info["terminal_observation"] = info["terminal_observation"]["observation"]
        return self._seen(observations), rewards, dones, infos

    def has_attr(self, attr_name: str) -> bool:
        return attr_name == "action_masks" or self.venv.has_attr(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        if method_name == "action_masks":
            return list(self.masks)
        return self.venv.env_method(method_name, *args, indices=indices, **kwargs)


def main(steps: int = 768) -> None:
    """Trains briefly and checks that no masked action is chosen."""
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    envs = Masks(RaceVecEnv(2, num_kart=3, track="lighthouse", view="masked_discrete"))
    model = MaskablePPO("MlpPolicy", envs, n_steps=64, batch_size=128, n_epochs=2, device="cpu")
    model.learn(steps)
    observations = envs.reset()
    for _ in range(30):
        masks = get_action_masks(envs)
        actions, _ = model.predict(observations, action_masks=masks)
        assert all(mask[action] for mask, action in zip(masks, actions, strict=True))
        observations, *_ = envs.step(actions)
    print("agents:", envs.num_envs, "allowed actions:", masks.sum(axis=1))
    envs.close()


if __name__ == "__main__":
    main()
