"""Gymnasium's vector API: many races as one batch of agents, and `gym.make_vec`.

python examples/ecosystem/gymnasium_vector.py
"""

import gymnasium as gym
import numpy as np
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import stkzoo

RACE = {"track": "lighthouse", "max_cycles": 60}


def many_agents() -> None:
    """Steps two races, with one slot per agent; `infos["active"]` marks real steps."""
    envs = stkzoo.RaceVectorEnv(2, num_kart=3, view="box_discrete", **RACE)
    observations, infos = envs.reset(seed=1)
    returns = np.zeros(envs.num_envs)
    for _ in range(130):
        actions = envs.action_space.sample()
        observations, rewards, terminations, truncations, infos = envs.step(actions)
        returns += np.where(infos["active"], rewards, 0)
    print("agents in one batch:", observations.shape, "returns:", returns.round(1))
    envs.close()


def one_agent_a_race() -> None:
    """Steps single-kart ids through `gym.make_vec`."""
    envs = gym.make_vec(
        "supertuxkart/box_discrete-v0",
        num_envs=2,
        vectorization_mode="vector_entry_point",
        num_kart=3,
        **RACE,
    )
    envs = RecordEpisodeStatistics(envs)
    envs.reset(seed=1)
    ended = 0
    while ended < 2:
        *_, terminations, truncations, infos = envs.step(envs.action_space.sample())
        ended += int(np.sum(terminations | truncations))
    print("races over:", ended, "lengths:", list(envs.length_queue))
    envs.close()


if __name__ == "__main__":
    many_agents()
    one_agent_a_race()
