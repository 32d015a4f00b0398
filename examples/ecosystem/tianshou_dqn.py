"""Tianshou: a DQN agent and a random agent take turns through PettingZoo's AEC API.

python examples/ecosystem/tianshou_dqn.py
"""

import torch
from tianshou.algorithm import DQN, MARLRandomDiscreteMaskedOffPolicyAlgorithm
from tianshou.algorithm.algorithm_base import policy_within_training_step
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.multiagent.marl import MultiAgentOffPolicyAlgorithm
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv, PettingZooEnv
from tianshou.utils.net.common import Net

from stkzoo import race_v0


def make_env() -> PettingZooEnv:
    """Returns a race of two agents; Tianshou finds the mask next to the observation by itself."""
    return PettingZooEnv(
        race_v0.env(num_kart=2, track="lighthouse", view="masked_discrete", max_cycles=40)
    )


def main(steps: int = 160) -> None:
    """Collects data and updates the policy."""
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    env = make_env()
    net = Net(
        state_shape=env.observation_space["observation"].shape,
        action_shape=env.action_space.n,
        hidden_sizes=[64, 64],
    )
    policy = DiscreteQLearningPolicy(
        model=net, action_space=env.action_space, eps_training=0.3, eps_inference=0.0
    )
    learner = DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3), target_update_freq=50)
    algorithm = MultiAgentOffPolicyAlgorithm(
        algorithms=[learner, MARLRandomDiscreteMaskedOffPolicyAlgorithm(env.action_space)], env=env
    )
    envs = DummyVectorEnv([make_env])
    buffer = VectorReplayBuffer(2000, len(envs))
    collector = Collector(algorithm, envs, buffer, exploration_noise=True)
    collector.reset()
    result = collector.collect(n_step=steps)
    with policy_within_training_step(algorithm.policy):
        statistics = algorithm.update(buffer=buffer, sample_size=32)
    print("steps:", result.n_collected_steps, "returns:", result.returns)
    print("losses:", statistics.get_loss_stats_dict())
    envs.close()


if __name__ == "__main__":
    main()
