"""SuperSuit: the usual way from PettingZoo to Stable-Baselines3.

`stkzoo.sb3.RaceVecEnv` (sb3_ppo.py) does the same without training on agents that have finished.

python examples/ecosystem/supersuit_sb3.py
"""

import supersuit
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from stkzoo import race_v0


def main(steps: int = 512) -> None:
    """Trains one policy for all agents of two races."""
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    env = race_v0.parallel_env(
        num_kart=3, track="lighthouse", view="box_discrete", reward="placement", max_cycles=300
    )
    env = supersuit.clip_reward_v0(env, lower_bound=-1, upper_bound=1)
    env = supersuit.frame_stack_v2(env, 2)
    env = supersuit.black_death_v3(env)  # zeros for finished agents
    env = supersuit.pettingzoo_env_to_vec_env_v1(env)
    env = supersuit.concat_vec_envs_v1(env, 2, num_cpus=1, base_class="stable_baselines3")
    env = VecMonitor(env)
    model = PPO("MlpPolicy", env, n_steps=64, batch_size=128, n_epochs=2, device="cpu")
    model.learn(steps)
    print("agents:", env.num_envs, "steps:", model.num_timesteps)
    env.close()


if __name__ == "__main__":
    main()
