"""TorchRL: a short MAPPO whose critic sees the state of the whole race.

python examples/ecosystem/torchrl_mappo.py
"""

import torch
from tensordict.nn import TensorDictModule
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import PettingZooWrapper, check_env_specs
from torchrl.modules import MultiAgentMLP, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from stkzoo import race_v0

KARTS = 3
#: All agents of a race form one group, because their names differ only in the number.
GROUP = "kart"


def make_env() -> PettingZooWrapper:
    """Returns a race in which no agent is done before the end, as a centralized critic requires."""
    race = race_v0.parallel_env(
        num_kart=KARTS, track="lighthouse", view="box_discrete", max_cycles=64
    )
    return PettingZooWrapper(
        race, use_mask=True, return_state=True, done_on_any=False, categorical_actions=True
    )


class Squash(nn.Module):
    """Compresses distances and times to similar magnitudes."""

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        return torch.sign(seen) * torch.log1p(seen.abs())


class CentralCritic(nn.Module):
    """Estimates one value per agent from the state of the race."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.net = nn.Sequential(Squash(), nn.Linear(size, 64), nn.Tanh(), nn.Linear(64, KARTS))

    def forward(self, state: torch.Tensor) -> torch.Tensor:
        return self.net(state).unsqueeze(-1)


def main(iterations: int = 3) -> None:
    """Checks the specs, collects whole races and updates the policy."""
    torch.manual_seed(1)
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    env = make_env()
    check_env_specs(env)
    size = env.observation_spec[GROUP, "observation"].shape[-1]
    count = env.full_action_spec[GROUP, "action"].space.n
    network = nn.Sequential(
        Squash(),
        MultiAgentMLP(
            n_agent_inputs=size,
            n_agent_outputs=count,
            n_agents=KARTS,
            centralized=False,
            share_params=True,
            num_cells=64,
            depth=2,
        ),
    )
    actor = ProbabilisticActor(
        TensorDictModule(network, in_keys=[(GROUP, "observation")], out_keys=[(GROUP, "logits")]),
        in_keys=[(GROUP, "logits")],
        out_keys=[(GROUP, "action")],
        distribution_class=torch.distributions.Categorical,
        return_log_prob=True,
        log_prob_key=(GROUP, "log_prob"),
    )
    critic = TensorDictModule(
        CentralCritic(env.observation_spec["state"].shape[-1]),
        in_keys=["state"],
        out_keys=[(GROUP, "state_value")],
    )
    loss_module = ClipPPOLoss(actor, critic, entropy_coeff=0.01, normalize_advantage=False)
    loss_module.set_keys(
        reward=(GROUP, "reward"),
        action=(GROUP, "action"),
        value=(GROUP, "state_value"),
        done=(GROUP, "done"),
        terminated=(GROUP, "terminated"),
        sample_log_prob=(GROUP, "log_prob"),
    )
    loss_module.make_value_estimator(ValueEstimators.GAE, gamma=0.99, lmbda=0.95)
    optimizer = torch.optim.Adam(loss_module.parameters(), 3e-4)
    collector = Collector(
        env,
        actor,
        frames_per_batch=64,
        total_frames=64 * iterations,
        auto_register_policy_transforms=True,
    )
    for batch in collector:
        with torch.no_grad():
            loss_module.value_estimator(
                batch,
                params=loss_module.critic_network_params,
                target_params=loss_module.target_critic_network_params,
            )
        losses = loss_module(batch)
        loss = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(loss_module.parameters(), 1.0)
        optimizer.step()
        reward = batch["next", GROUP, "reward"].sum(0).squeeze(-1)
        print("returns:", [round(value, 1) for value in reward.tolist()], "loss:", loss.item())
        assert torch.isfinite(loss)
    collector.shutdown()


if __name__ == "__main__":
    main()
