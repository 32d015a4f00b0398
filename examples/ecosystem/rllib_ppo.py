"""Ray RLlib, new API stack: one PPO policy for all agents.

python examples/ecosystem/rllib_ppo.py
"""

from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

from stkzoo import race_v0


def make_env(config: dict) -> ParallelPettingZooEnv:
    """Returns a race in RLlib's form."""
    return ParallelPettingZooEnv(
        race_v0.parallel_env(
            num_kart=3, track="lighthouse", view="box_discrete", max_cycles=64, **config
        )
    )


def main(iterations: int = 2) -> None:
    """Trains for a number of iterations."""
    register_env("stkzoo_race", make_env)
    config = (
        PPOConfig()
        .environment("stkzoo_race", env_config={"reward": "placement"})
        .env_runners(num_env_runners=0, rollout_fragment_length=64)
        .multi_agent(policies={"driver"}, policy_mapping_fn=lambda *_, **__: "driver")
        .training(train_batch_size_per_learner=192, minibatch_size=96, num_epochs=2)
        .rl_module(model_config=DefaultModelConfig(fcnet_hiddens=[64, 64]))
    )
    algorithm = config.build_algo()
    for _ in range(iterations):
        result = algorithm.train()
        runners = result["env_runners"]
        print("agent steps:", runners["num_agent_steps_sampled_lifetime"])
    assert sum(runners["num_agent_steps_sampled_lifetime"].values()) >= iterations * 192
    algorithm.stop()


if __name__ == "__main__":
    main()
