# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A first race
#
# Race four karts on a short track. You look at what an agent observes, drive with a short rule, and plot
# the paths of the karts.

# %%
import os

import matplotlib.pyplot as plt
import numpy as np

from stkzoo import race_v0

SHORT = "STKZOO_SHORT" in os.environ  # for a quick test of this notebook
np.set_printoptions(suppress=True, precision=1)

# %% [markdown]
# ## Create a race
#
# Observations in the view `simple` are dicts of fixed size. Positions are polar: angle to the right
# [rad], angle up [rad], distance [m].

# %%
env = race_v0.parallel_env(
    num_kart=4,
    track="olivermath",
    view="simple",
    render_mode="rgb_array",
    render_backend="map",
    max_cycles=60 if SHORT else 600,
)
observations, infos = env.reset(seed=42)
print(env.agents, "on", env.race.track, f"({env.track_map.length:.0f} m)")
for key in ("velocity", "center_path_distance", "paths_end", "karts_position"):
    print(f"{key}:", *np.atleast_2d(observations["kart_0"][key]).round(1), sep="\n    ")

# %%
plt.figure(figsize=(7, 5))
plt.imshow(env.render())
plt.axis("off")
plt.show()

# %% [markdown]
# ## A rule that drives
#
# Steer toward a point on the road ahead, at full throttle. `paths_end[i]` is the end of the i-th road
# segment ahead. Each of the four drivers aims at a different segment.


# %%
def drive(observation, ahead):
    angle = observation["paths_end"][ahead][0]
    return {
        "acceleration": np.array([1.0], np.float32),
        "steer": np.array([np.clip(2.5 * angle, -1, 1)], np.float32),
        "brake": 0,
        "drift": 0,
        "fire": 1,
        "nitro": 1,
        "rescue": 0,
    }


places, speeds, finished = {a: [] for a in env.agents}, {a: [] for a in env.agents}, {}
while env.agents:
    actions = {
        a: drive(observations[a], ahead)
        for ahead, a in enumerate(env.possible_agents)
        if a in env.agents
    }
    observations, rewards, terminations, truncations, infos = env.step(actions)
    for kart, agent in zip(env.race.kart_indices, env.possible_agents, strict=True):
        if agent in observations:
            places[agent].append(env.snapshot.karts["location"][kart, [0, 2]].copy())
            speeds[agent].append(float(np.linalg.norm(observations[agent]["velocity"])))
            if terminations[agent]:
                finished[agent] = infos[agent]["finish_time"]

# %% [markdown]
# ## Compare the drivers
#
# A driver that aims at a near segment turns too late and hits a wall. One that aims farther ahead cuts
# the corners and wins.

# %%
for ahead, agent in enumerate(env.possible_agents):
    end = f"finished in {finished[agent]:.1f} s" if agent in finished else "did not finish"
    print(f"{agent}, aiming {ahead} segments ahead: {end}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4))
for start, end in env.track_map.path_nodes[:, :, [0, 2]]:
    left.plot(
        *zip(start, end, strict=True), color="0.85", linewidth=9, solid_capstyle="round", zorder=0
    )
for agent, path in places.items():
    left.plot(*np.array(path).T, label=agent, linewidth=1.5)
    right.plot(np.arange(len(speeds[agent])) / 10, speeds[agent], label=agent)
left.set_aspect("equal")
left.axis("off")
right.set(xlabel="time [s]", ylabel="speed [m/s]")
right.legend()
plt.show()

# %%
plt.figure(figsize=(7, 5))
plt.imshow(env.render())
plt.axis("off")
plt.show()
env.close()

# %% [markdown]
# The same seed gives the same race, bit for bit. Run the notebook again to check.
#
# Next, put your rule into [an agent](first-agent.md), or [train a driver](train_a_driver.ipynb).
