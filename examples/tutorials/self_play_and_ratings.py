# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Self-play and ratings
#
# A policy that races against itself always meets rivals of its own strength. Train such a policy, save a
# copy (a *generation*) after each stage, and run a tournament to see whether later generations are
# better. This takes about five minutes and needs the extras `sb3` and `races`: see
# [Install](../how-to/install.md).

# %%
import os

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO

from stkzoo.evaluation import run_tournament
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv, save_agent

SHORT = "STKZOO_SHORT" in os.environ  # for a quick test of this notebook
TRACK = "olivermath"
torch.set_num_threads(1)  # the network is small; leave the cores to the races

# %% [markdown]
# ## Generations
#
# One policy drives all karts in all races. The default reward pays for progress and for gaining places.
# [Train a driver](train_a_driver.ipynb) explains the settings.

# %%
races = RaceVecEnv(
    4, num_kart=4, track=TRACK, view="racing", start="random", max_cycles=250, prefetch=True
)
model = PPO(
    "MlpPolicy",
    races,
    rollout_buffer_class=ActiveRolloutBuffer,
    n_steps=128,
    batch_size=512,
    n_epochs=4,
    learning_rate=5e-4,
    gamma=0.98,
    gae_lambda=0.95,
    ent_coef=0.003,
    policy_kwargs={"net_arch": [128, 128]},
    seed=1,
    device="cpu",
)
GO, RESCUE = 21, 24
with torch.no_grad():
    model.policy.action_net.bias[GO] += 1.5
    model.policy.action_net.bias[RESCUE] -= 3.0

generations = []
for number in range(4):
    if number > 0:
        model.learn(2_048 if SHORT else 60_000, reset_num_timesteps=False)
    name = f"generation {number}"
    generations.append(save_agent(model, f"generation_{number}", view="racing", name=name))
races.close()
print(f"{model.num_timesteps:,} steps, {len(generations)} generations")

# %% [markdown]
# ## Compare the generations
#
# In a [tournament](../how-to/tournaments.md), every agent starts equally often from each grid place. An
# interval shows how much a rating would vary with other races. If the intervals of two agents do not
# overlap, one of them is better.

# %%
result = run_tournament(
    [*generations, "random"],
    tracks=[TRACK],
    races=5 if SHORT else 40,
    per_race=5,
    output="league",
    max_steps=40 if SHORT else 500,
)
for row in result.standings:
    rating = row.rating
    print(
        f"{row.place}  {row.label:14} {rating.value:6.1f}   {rating.low:6.1f} to {rating.high:6.1f}"
    )

# %%
figure, axes = plt.subplots(figsize=(7, 3))
labels = [row.label for row in result.standings][::-1]
ratings = [row.rating for row in result.standings][::-1]
values = np.array([rating.value for rating in ratings])
errors = [values - [r.low for r in ratings], [r.high for r in ratings] - values]
axes.errorbar(values, range(len(labels)), xerr=np.abs(errors), fmt="o", capsize=3)
axes.set_yticks(range(len(labels)), labels)
axes.set_xlabel("rating, 95 % interval")
axes.grid(alpha=0.3)
plt.show()

# %% [markdown]
# ## Past selves as rivals
#
# A policy that races only against itself may forget how to beat earlier generations. An
# [opponent pool](../how-to/opponents.md#self-play-against-past-selves) adds earlier generations to the
# training races.
