# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Train a driver
#
# Train a policy with PPO from Stable-Baselines3 for about five minutes. It learns to finish a lap of
# lighthouse faster than the game's easiest AI. Then save it as an agent and race it. You need the extras
# `sb3` and `races`: see [Install](../how-to/install.md).

# %%
import os
import time

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from stkzoo.race import run_race
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv, save_agent

SHORT = "STKZOO_SHORT" in os.environ  # for a quick test of this notebook
STEPS = int(os.environ.get("STKZOO_STEPS", 10_240 if SHORT else 600_000))
SEED = int(os.environ.get("STKZOO_SEED", 1))
torch.set_num_threads(1)  # the network is small; leave the cores to the races

# %% [markdown]
# ## The races
#
# The view `racing` observes the road ahead, the other karts and the items as one vector, and its action
# is five small choices. All four karts of a race are agents, so each step of the race gives four
# transitions to learn from. With `start="random"`, the policy sees every corner from the beginning. The
# [default reward](../how-to/choose-a-reward.md) pays for progress, for gaining places and for finishing,
# and costs a little in every step.

# %%
TRACK = "lighthouse"
races = RaceVecEnv(
    4, num_kart=4, track=TRACK, view="racing", start="random", max_cycles=250, prefetch=True
)
print(races.observation_space, races.action_space)

# %% [markdown]
# ## The policy
#
# `ActiveRolloutBuffer` leaves out agents that have finished and are waiting for the others.
#
# An untrained policy takes all actions equally often, so it brakes and calls for a rescue as often as it
# accelerates. Raise the odds of the accelerator and lower those of the rescue; training can change both
# later. The outputs of the last layer are, in this order: 21 steering angles, 4 pedals (go, roll, brake,
# rescue) and 3 buttons.

# %%
model = PPO(
    "MlpPolicy",
    races,
    rollout_buffer_class=ActiveRolloutBuffer,
    n_steps=128,
    batch_size=512,
    n_epochs=4,
    learning_rate=lambda left: 5e-4 * left,  # left: from 1 to 0
    gamma=0.98,
    gae_lambda=0.95,
    ent_coef=0.003,
    policy_kwargs={"net_arch": [128, 128]},
    seed=SEED,
    device="cpu",
)
GO, RESCUE = 21, 24
with torch.no_grad():
    model.policy.action_net.bias[GO] += 1.5
    model.policy.action_net.bias[RESCUE] -= 3.0

# %% [markdown]
# ## An agent in a folder
#
# An agent is a folder with a `pystk_actor.py`. `save_agent` writes one that needs only numpy, not torch,
# and starts in a tenth of a second. Save the untrained policy for comparison.


# %%
untrained = save_agent(model, "untrained", view="racing", name="Untrained")

# %% [markdown]
# ## Training


# %%
class Curve(BaseCallback):
    """Records the mean speed along the track of each finished episode."""

    def __init__(self):
        super().__init__()
        self.steps, self.speeds = [], []

    def _on_step(self):
        for info in self.locals["infos"]:
            if "episode" in info and info["active"]:
                seconds = 0.1 * info["episode"]["l"]
                self.steps.append(self.num_timesteps)
                self.speeds.append(10 * info["episode/reward/advance"] / seconds)
        return True


curve, begun = Curve(), time.time()
model.learn(STEPS, callback=curve)
races.close()
model.save("driver.zip")  # PPO.load("driver.zip") reads it again
print(f"{model.num_timesteps:,} steps in {time.time() - begun:.0f} s")

# %%
if len(curve.speeds) > 20:
    parts = [np.mean(part) for part in np.array_split(curve.speeds, 20)]
    at = [np.mean(part) for part in np.array_split(curve.steps, 20)]
    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    axes.plot(at, parts)
    axes.set(xlabel="steps of training", ylabel="speed along the track [m/s]")
    axes.grid(alpha=0.3)
    plt.show()

# %% [markdown]
# ## Before and after
#
# Race both policies over a whole lap, from the grid, against the game's easiest AI and a driver that
# takes random actions. The policy met neither in training. `difficulty=0` also slows all karts down:
# compare times only at the same [difficulty](../reference/environment.md#difficulty).

# %%
trained = save_agent(model, "my_driver", view="racing", name="Trained")
drivers = [trained, untrained, "ai", "random"]
seeds = range(1, 2 if SHORT else 6)
table = {}
for seed in seeds:
    result = run_race(drivers, track=TRACK, difficulty=0, seed=seed, max_steps=60 if SHORT else 900)
    for row in result.agents:
        table.setdefault(row.driver, []).append(row)
print(f"{'driver':12} {'finished':>9} {'mean time':>10} {'mean place':>11}")
for name, rows in table.items():
    times = [row.finish_time for row in rows if row.finish_time is not None]
    mean = f"{np.mean(times):.1f} s" if times else "-"
    place = np.mean([row.rank for row in rows])
    print(f"{name:12} {len(times):>4} of {len(rows)} {mean:>10} {place:>11.1f}")

# %% [markdown]
# ## Next steps
#
# - [Record a video](../how-to/rendering.md): `stkzoo race my_driver ai ai ai --track lighthouse --video race.mp4`.
# - [Watch it in the browser](../how-to/live-page.md): `--web` instead of `--video race.mp4`.
# - Train longer, on more tracks (`track="train"`), against [opponents](../how-to/opponents.md).
# - [Measure the driver](../reference/benchmark-protocol.md) on unseen tracks: `stkzoo benchmark my_driver`.
