"""Stable-Baselines3: PPO drives every agent of every race.

python examples/ecosystem/sb3_ppo.py
"""

import torch
from stable_baselines3 import PPO

from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv


def main(steps: int = 768) -> None:
    """Trains briefly and continues to drive with the trained policy."""
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    envs = RaceVecEnv(2, num_kart=3, track="train", view="box_continuous", max_cycles=300)
    model = PPO(
        "MlpPolicy",
        envs,
        rollout_buffer_class=ActiveRolloutBuffer,  # excludes agents that have finished
        n_steps=64,
        batch_size=128,
        n_epochs=2,
        seed=1,
        device="cpu",
    )
    model.learn(steps)
    observations = envs.reset()
    for _ in range(20):
        actions, _ = model.predict(observations, deterministic=True)
        observations, *_ = envs.step(actions)
    print("agents:", envs.num_envs, "steps:", model.num_timesteps)
    envs.close()


if __name__ == "__main__":
    main()
