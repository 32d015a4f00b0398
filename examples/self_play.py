"""PPO against its past selves: python examples/self_play.py [GENERATIONS STEPS DUELS]."""

import sys

import torch
from stable_baselines3 import PPO

from stkzoo import OpponentPool, Reward
from stkzoo.mdp.rewards import advance, overtaking
from stkzoo.race import run_race
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv

TRACKS = ["lighthouse", "cornfield_crossing", "gran_paradiso_island", "olivermath", "hacienda"]
# 0.1 per meter driven, up to 50 m/s, and 0.3 per place gained.
terms = {"advance": advance, "overtaking": overtaking}
reward = Reward(terms, {"overtaking": 0.3}, {"advance": 5.0})

generations, steps, duels = map(int, sys.argv[1:] or (12, 25_000, 50))
torch.set_num_threads(1)  # a small network; leave the cores to the races
pool, won = OpponentPool(), 0
race = {"track": TRACKS, "start": "random", "max_cycles": 300, "reward": reward}
envs = RaceVecEnv(8, agents=2, num_kart=3, opponents=pool, view="racing", **race)
learning = {"n_steps": 128, "batch_size": 512, "n_epochs": 4, "learning_rate": 5e-4}
learning |= {"gamma": 0.98, "ent_coef": 0.003, "rollout_buffer_class": ActiveRolloutBuffer}
model = PPO("MlpPolicy", envs, seed=1, device="cpu", **learning)
model.policy.action_net.bias.data[[21, 24, 25]] += torch.tensor([1.5, -3.0, 2.0])  # go, rescue
first = last = pool.add(model, view="racing", name="first")
for number in range(generations):
    model.learn(steps, reset_num_timesteps=False)
    last = pool.add(model, view="racing", name=f"self {number + 1}")
envs.close()
for n in range(duels):  # on each track, from both places of the grid
    here = {"track": TRACKS[n // 2 % len(TRACKS)], "start_positions": [1 + n % 2, 2 - n % 2]}
    result = run_race([last, first], seed=n, karts_finished=1, max_steps=600, **here)
    won += next(row.rank for row in result.agents if row.driver == last.name) == 1
print(f"{model.num_timesteps:,} steps; the last self won {won} of {duels} duels with the first")
