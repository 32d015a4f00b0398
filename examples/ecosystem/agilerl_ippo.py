"""AgileRL: IPPO on its asynchronous vector of PettingZoo environments.

python examples/ecosystem/agilerl_ippo.py
"""

import functools

import torch
from agilerl.algorithms import IPPO
from agilerl.training.train_multi_agent_on_policy import train_multi_agent_on_policy
from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv

from stkzoo import race_v0


def main(steps: int = 256) -> None:
    """Trains one agent per kart, all in one group, in two parallel races."""
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    make_env = functools.partial(
        race_v0.parallel_env, num_kart=2, track="lighthouse", view="box_continuous", max_cycles=60
    )
    envs = AsyncPettingZooVecEnv([make_env] * 2)
    agent = IPPO(
        observation_spaces=[envs.single_observation_space(name) for name in envs.agents],
        action_spaces=[envs.single_action_space(name) for name in envs.agents],
        agent_ids=list(envs.agents),
        batch_size=32,
        learn_step=64,
        net_config={"encoder_config": {"hidden_size": [64, 64]}},
    )
    _, fitnesses = train_multi_agent_on_policy(
        envs,
        env_name="stkzoo",
        algo="IPPO",
        pop=[agent],
        max_steps=steps,
        evo_steps=128,
        eval_steps=20,
        verbose=False,
    )
    print("steps:", agent.steps, "fitness:", fitnesses)
    envs.close()


if __name__ == "__main__":
    main()
