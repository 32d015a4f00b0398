# ---
# jupyter:
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Plan with saved states
#
# Save the whole state of a running race, including bots, items and random numbers, and return to it. The
# game itself is the model: a driver tries several futures and picks the best one.

# %%
import os
import time

import matplotlib.pyplot as plt
import numpy as np

from stkzoo import race_v0

SHORT = "STKZOO_SHORT" in os.environ  # for a quick test of this notebook

# %% [markdown]
# ## Go back in time
#
# Drive for five seconds, go back, and repeat the same actions. The result is the same, bit for bit.

# %%
env = race_v0.parallel_env(agents=1, num_kart=3, track="olivermath", view="simple")
observations, _ = env.reset(seed=1)


def act(observation, offset=0.0):
    """Full throttle along the road, with an offset added to the steering."""
    angle = observation["paths_end"][2][0]
    buttons = dict.fromkeys(["brake", "drift", "fire", "rescue"], 0)
    return {
        "acceleration": np.array([1.0], np.float32),
        "steer": np.array([np.clip(2.5 * angle + offset, -1, 1)], np.float32),
        "nitro": 1,
        **buttons,
    }


def follow(race, observation, steps, offset=0.0):
    """Drives on. Returns the path, the distance [m] and the last observation."""
    kart, path = race.race.kart_indices[0], []
    for _ in range(steps):
        if not race.agents:
            break
        observations, _, _, _, infos = race.step({"kart_0": act(observation, offset)})
        observation, distance = observations["kart_0"], infos["kart_0"]["distance"]
        path.append(race.snapshot.karts["location"][kart, [0, 2]].copy())
    return np.array(path), distance, observation


_, _, observation = follow(env, observations["kart_0"], 50)
state = env.save_state()
first, distance, _ = follow(env, observation, 50)
env.restore_state(state)
second, _, _ = follow(env, observation, 50)
print("the same bits:", first.tobytes() == second.tobytes())

# %% [markdown]
# ## Compare futures
#
# `env.lookahead()` returns a copy of the race. You can step the copy while the original waits.

# %%
offsets = np.linspace(-0.6, 0.6, 3 if SHORT else 9)
env.restore_state(state)
began, futures = time.perf_counter(), []
with env.lookahead() as branch:
    start = branch.save_state()
    for offset in offsets:
        branch.restore_state(start)
        futures.append(follow(branch, observation, 15 if SHORT else 40, offset)[:2])
    start.close()
spent = time.perf_counter() - began
print(f"{len(offsets)} futures of {len(futures[0][0]) / 10:.0f} s each in {spent:.2f} s")

# %%
figure, axes = plt.subplots(figsize=(7, 4))
for segment in env.track_map.path_nodes[:, :, [0, 2]]:
    axes.plot(*segment.T, color="0.85", linewidth=12, solid_capstyle="round", zorder=0)
best = max(range(len(futures)), key=lambda number: futures[number][1])
for number, (path, _) in enumerate(futures):
    axes.plot(
        *path.T,
        color="tab:green" if number == best else "tab:blue",
        alpha=1.0 if number == best else 0.4,
    )
points = np.concatenate([path for path, _ in futures])
axes.set_xlim(points[:, 0].min() - 15, points[:, 0].max() + 15)
axes.set_ylim(points[:, 1].min() - 15, points[:, 1].max() + 15)
axes.set_aspect("equal")
axes.axis("off")
axes.set_title(f"Best steering offset: {offsets[best]:+.2f} ({futures[best][1]:.0f} m)")
plt.show()

# %% [markdown]
# ## A driver that plans
#
# Every half second, this driver tries several steering offsets for three seconds each and picks the best
# one. Its forecasts contain exactly the bots, items and collisions that it would meet.


# %%
def race(plans, horizon=30, hold=5):
    """Returns the distance after each step [m] and the finish time, with or without planning."""
    observation, driven = env.reset(seed=1)[0]["kart_0"], []
    branch = env.clone() if plans else None
    limit = 40 if SHORT else 600
    while env.agents and len(driven) < limit:
        offset = 0.0
        if plans:
            with env.save_state() as now:
                scores = []
                for change in plans:
                    branch.restore_state(now)
                    scores.append(follow(branch, observation, horizon, change)[1])
                offset = plans[int(np.argmax(scores))]
        for _ in range(hold):
            if env.agents:
                observations, _, _, _, infos = env.step({"kart_0": act(observation, offset)})
                observation = observations["kart_0"]
                driven.append(infos["kart_0"]["distance"])
    if branch is not None:
        branch.close()
    return driven, infos["kart_0"]["finish_time"]


plain, plain_time = race([])
planned, planned_time = race([0.0, -0.4, 0.4] if SHORT else [0.0, -0.5, -0.25, 0.25, 0.5])
print(f"finish time without planning: {plain_time:.1f} s, with planning: {planned_time:.1f} s")

# %%
figure, axes = plt.subplots(figsize=(7, 3))
axes.plot(np.arange(len(plain)) / 10, plain, label="without planning")
axes.plot(np.arange(len(planned)) / 10, planned, label="with planning")
axes.set(xlabel="time [s]", ylabel="distance [m]")
axes.legend()
axes.grid(alpha=0.3)
plt.show()
state.close()
env.close()

# %% [markdown]
# [Save states and plan](../how-to/planning.md) lists all calls and what they cost, and describes
# `stkzoo.agents.planner`, a planner that improves another driver's choices.
