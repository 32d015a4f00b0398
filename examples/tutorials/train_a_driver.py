# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Train a driver in ten minutes
#
# One policy drives every kart of several races at once, with PPO from Stable-Baselines3. At the end
# it is an agent in a folder, and races the game's AI. `pip install "stkzoo[sb3]"`.

# %%
import os
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from stkzoo import Reward
from stkzoo.race import run_race
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv

SHORT = "STKZOO_SHORT" in os.environ  # a test runs this page in seconds
torch.set_num_threads(1)  # a small network; the cores are for the races

# %% [markdown]
# ## The races
#
# The view `racing` is made for learning: the road ahead, karts and items as one vector of numbers of
# like size, and five small choices to act by. All four karts of a race are agents, so each step of
# the game gives four steps to learn from. Races start anywhere on the track, which shows the learner
# every corner from the first minute on. The reward is the way driven, and nothing else.


# %%
def metres(step):
    """A tenth of the metres driven, at most 1: off the road the game may count in leaps."""
    return np.clip((step.distance - step.distance_before) / 10, -1.0, 1.0)


TRACK = "lighthouse"
races = RaceVecEnv(
    1 if SHORT else 4,
    num_kart=4,
    track=TRACK,
    view="racing",
    start="random",
    reward=Reward({"metres": metres}),
    max_cycles=60 if SHORT else 250,
)
races.observation_space, races.action_space

# %% [markdown]
# ## Learning
#
# `ActiveRolloutBuffer` leaves out the steps of agents that have finished and wait for the others.


# %%
class Curve(BaseCallback):
    """Keeps how far the agents of finished races came, and when."""

    def __init__(self):
        super().__init__()
        self.seconds, self.metres, self.steps = [], [], []
        self.begun = time.time()

    def _on_step(self):
        for info in self.locals["infos"]:
            if "episode" in info and info["active"]:
                self.seconds.append(time.time() - self.begun)
                self.metres.append(10 * info["episode"]["r"])
                self.steps.append(info["episode"]["l"])
        return time.time() - self.begun < 600


model = PPO(
    "MlpPolicy",
    races,
    rollout_buffer_class=ActiveRolloutBuffer,
    n_steps=64 if SHORT else 128,
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
curve = Curve()
model.learn(256 if SHORT else 3_000_000, callback=curve)
races.close()
print(f"{model.num_timesteps} steps in {time.time() - curve.begun:.0f} s")

# %%
size = max(len(curve.metres) // 40, 1)
groups = len(curve.metres) // size
if groups:
    way, steps, seconds = (
        np.array(values[: groups * size]).reshape(groups, size).sum(1)
        for values in (curve.metres, curve.steps, curve.seconds)
    )
    speeds, minutes = 10 * way / steps, seconds / size / 60
    figure, axes = plt.subplots(figsize=(7, 3))
    axes.plot(minutes, speeds)
    axes.set(xlabel="minutes of training", ylabel="metres of the way a second")
    axes.grid(alpha=0.3)
    plt.show()

# %% [markdown]
# ## An agent in a folder
#
# A `pystk_actor.py` makes the policy something that anybody can race. Two layers need no torch: the
# agent loads in a tenth of a second, wherever numpy is.


# %%
ACTOR = """
import numpy as np

env_name = "supertuxkart/racing-v0"
player_name = "{name}"


def get_actor(module_dir, observation_space, action_space):
    data = np.load(module_dir / "policy.npz")
    *hidden, last = [(data[f"w{{n}}"], data[f"b{{n}}"]) for n in range(len(data.files) // 2)]
    ends = np.cumsum(action_space.nvec)[:-1]

    def actor(state, observation):
        for weights, bias in hidden:
            observation = np.tanh(weights @ observation + bias)
        weights, bias = last
        logits = np.split(weights @ observation + bias, ends)
        return np.array([choice.argmax() for choice in logits])

    return actor
"""


def save_agent(model, folder, name):
    """Writes an agent that drives as the policy does, by numpy alone."""
    folder.mkdir(parents=True, exist_ok=True)
    layers = [*model.policy.mlp_extractor.policy_net, model.policy.action_net]
    layers = [layer for layer in layers if isinstance(layer, torch.nn.Linear)]
    arrays = {f"w{n}": layer.weight.detach().numpy() for n, layer in enumerate(layers)}
    arrays |= {f"b{n}": layer.bias.detach().numpy() for n, layer in enumerate(layers)}
    np.savez(folder / "policy.npz", **arrays)
    (folder / "pystk_actor.py").write_text(ACTOR.format(name=name))
    return str(folder)


folder = save_agent(model, Path("ten_minutes"), "Ten minutes")

# %% [markdown]
# ## Against the game's AI
#
# Now from the grid, over a whole lap, with what it has never met: the game's own drivers.

# %%
result = run_race([folder, "ai", "ai", "ai"], track=TRACK, seed=1, max_steps=60 if SHORT else 900)
for row in result.agents:
    finish = "not finished" if row.finish_time is None else f"{row.finish_time:.1f} s"
    print(f"{row.rank}  {row.driver:12} {finish:>12}  {row.distance:5.0f} m")

# %% [markdown]
# From a shell it is the same: `stkzoo race ten_minutes ai ai ai --track lighthouse --record race.mp4`.
#
# More tracks (`track="train"`), more minutes and rivals at `difficulty=3` make it a better driver;
# `stkzoo benchmark ten_minutes` measures it on [tracks that it has not seen](../reference/benchmark-protocol.md).
