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
# A policy that races against itself always has rivals of its own strength. Is the later one really
# better than the earlier? A tournament says, with intervals. `pip install "stkzoo[sb3,tournament]"`.

# %%
import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from stable_baselines3 import PPO

from stkzoo import Reward
from stkzoo.evaluation import run_tournament
from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv

SHORT = "STKZOO_SHORT" in os.environ  # a test runs this page in seconds
TRACK = "olivermath"
torch.set_num_threads(1)  # a small network; the cores are for the races

# %% [markdown]
# ## Generations
#
# All karts of all races are driven by the same policy, so its rivals are as good as itself, always.
# The place counts in the reward, beside the way driven. Now and then the policy is kept: a
# *generation*.


# %%
def metres(step):
    """A tenth of the metres driven, at most 1: off the road the game may count in leaps."""
    return np.clip((step.distance - step.distance_before) / 10, -1.0, 1.0)


def place(step):
    """A little for each kart that is behind."""
    return 0.05 * (step.num_kart - step.position) / step.num_kart


races = RaceVecEnv(
    1 if SHORT else 4,
    num_kart=4,
    track=TRACK,
    view="racing",
    start="random",
    reward=Reward({"metres": metres, "place": place}),
    max_cycles=60 if SHORT else 200,
)
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


generations = []
for number in range(2 if SHORT else 3):
    if number > 0:
        model.learn(256 if SHORT else 8_000, reset_num_timesteps=False)
    name = f"generation {number}"
    generations.append(save_agent(model, Path("generations") / f"generation_{number}", name))
races.close()
print(model.num_timesteps, "steps;", len(generations), "generations")

# %% [markdown]
# ## Who is better?
#
# Each agent of a tournament races as often as the others, on each track and from each place of the
# grid. The ratings take whole orders; the intervals answer whether another set of races would have said
# the same.

# %%
result = run_tournament(
    [*generations, "random"] if SHORT else [*generations, "random", "ai"],
    tracks=[TRACK],
    races=3 if SHORT else 16,
    per_race=3 if SHORT else 4,
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
# Here each generation is above the one before, with intervals that overlap; after 16,000 steps even the
# last is still behind `random`, which presses buttons by chance. That is what ratings are for.
# The driver of [ten minutes](train_a_driver.ipynb) finishes its lap: minutes count.
#
# ## Past selves as rivals
#
# A policy that meets only itself may forget how to beat what it once beat. Then some of the karts are
# driven by kept generations: give those agents to your loop as constants, or race the folders above.
# [Tournaments](../how-to/tournaments.md) keep every race as a file and go on where they were interrupted.
