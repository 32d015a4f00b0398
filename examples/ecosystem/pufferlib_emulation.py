"""PufferLib: its emulation converts any view, and all agents of many races, to flat arrays.

python examples/ecosystem/pufferlib_emulation.py
"""

import functools

import numpy as np
import pufferlib.emulation
import pufferlib.vector

from stkzoo import race_v0


def make_env(view: str, buf=None, seed: int = 0) -> pufferlib.emulation.PettingZooPufferEnv:
    """Returns a race inside PufferLib's emulation."""
    make_race = functools.partial(
        race_v0.parallel_env, num_kart=3, track="lighthouse", view=view, max_cycles=50
    )
    return pufferlib.emulation.PettingZooPufferEnv(env_creator=make_race, buf=buf, seed=seed)


def main(view: str) -> None:
    """Drives two parallel races at random, beyond their ends."""
    envs = pufferlib.vector.make(
        make_env, env_args=[view], num_envs=2, backend=pufferlib.vector.Serial
    )
    observations, _ = envs.reset(seed=1)
    returns = np.zeros(envs.num_agents)
    for _ in range(120):
        actions = envs.action_space.sample()
        observations, rewards, terminals, truncations, infos = envs.step(actions)
        returns += rewards
    print(view, observations.shape, observations.dtype, "returns:", returns.round(1))
    envs.close()


if __name__ == "__main__":
    main("box_discrete")
    main("flattened_multidiscrete")  # a Dict, packed into bytes
