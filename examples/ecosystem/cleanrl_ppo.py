"""PPO with shared parameters in one file, in the style of CleanRL, with PyTorch only.

It learns to drive lighthouse, and at the end drives one lap alone.

python examples/ecosystem/cleanrl_ppo.py
"""

import argparse
import time

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import stkzoo
from stkzoo.race import Driver, run_race


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--total-steps", type=int, default=100_000, help="of all agents together")
    parser.add_argument("--races", type=int, default=4)
    parser.add_argument("--karts", type=int, default=4, help="in each race, all of them agents")
    parser.add_argument("--track", default="lighthouse")
    parser.add_argument("--horizon", type=int, default=64)
    parser.add_argument("--minibatches", type=int, default=4)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--learning-rate", type=float, default=1e-3)
    parser.add_argument("--gamma", type=float, default=0.98)
    parser.add_argument("--gae-lambda", type=float, default=0.95)
    parser.add_argument("--clip", type=float, default=0.2)
    parser.add_argument("--entropy", type=float, default=0.003)
    return parser.parse_args()


def layer(inputs: int, outputs: int, std: float = 2**0.5) -> nn.Linear:
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, std)
    nn.init.zeros_(linear.bias)
    return linear


class Agent(nn.Module):
    """An actor with one head for each part of an action, and a critic."""

    def __init__(self, size: int, parts: list[int]) -> None:
        super().__init__()
        self.parts = parts
        self.critic = nn.Sequential(
            layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0)
        )
        self.actor = nn.Sequential(
            layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, sum(parts), 0.01)
        )
        with torch.no_grad():  # begin with the accelerator, and without the rescue button
            self.actor[-1].bias[21] += 1.5
            self.actor[-1].bias[24] -= 3.0

    def forward(self, seen, action=None):
        heads = [Categorical(logits=part) for part in self.actor(seen).split(self.parts, -1)]
        if action is None:
            action = torch.stack([head.sample() for head in heads], -1)
        logprob = sum(
            head.log_prob(part) for head, part in zip(heads, action.unbind(-1), strict=True)
        )
        entropy = sum(head.entropy() for head in heads)
        return action, logprob, entropy, self.critic(seen).squeeze(-1)

    @torch.no_grad()
    def drive(self, seen: np.ndarray) -> np.ndarray:
        """Returns the most likely action for one observation."""
        heads = self.actor(torch.as_tensor(seen)).split(self.parts)
        return torch.stack([head.argmax() for head in heads]).numpy()


def main() -> None:
    args = arguments()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    envs = stkzoo.RaceVectorEnv(
        args.races,
        num_kart=args.karts,
        track=args.track,
        view="racing",
        start="random",  # the policy sees every corner from the beginning
        max_cycles=250,
    )
    slots, size = envs.num_envs, envs.single_observation_space.shape[0]
    parts = envs.single_action_space.nvec.tolist()  # steering, pedals, drift, nitro, fire
    agent = Agent(size, parts)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)

    shape = (args.horizon, slots)
    seen_buffer = torch.zeros((*shape, size))
    actions_buffer = torch.zeros((*shape, len(parts)), dtype=torch.long)
    logprobs, rewards, dones, values, active = (torch.zeros(shape) for _ in range(5))

    seen = torch.as_tensor(envs.reset(seed=args.seed)[0])
    begun, steps, returns = time.time(), 0, []
    while steps < args.total_steps:
        for t in range(args.horizon):
            seen_buffer[t] = seen
            with torch.no_grad():
                action, logprobs[t], _, values[t] = agent(seen)
            actions_buffer[t] = action
            observations, reward, terminated, truncated, infos = envs.step(action.numpy())
            rewards[t] = torch.as_tensor(reward)
            if truncated.any():  # an episode cut short: its last state still has a value
                last = np.stack([infos["final_obs"][slot] for slot in truncated.nonzero()[0]])
                with torch.no_grad():
                    rewards[t, truncated] += args.gamma * agent(torch.as_tensor(last))[3]
            dones[t] = torch.as_tensor(terminated | truncated)
            active[t] = torch.as_tensor(infos["active"])  # finished agents have no transitions
            seen = torch.as_tensor(observations)
            steps += int(infos["active"].sum())
            if "final_info" in infos:
                returns.extend(infos["final_info"]["episode"]["r"][infos["_final_info"]])

        with torch.no_grad():
            last_value = agent(seen)[3]
            advantages, after = torch.zeros(shape), torch.zeros(slots)
            for t in reversed(range(args.horizon)):
                next_value = values[t + 1] if t + 1 < args.horizon else last_value
                goes_on = 1 - dones[t]
                delta = rewards[t] + args.gamma * next_value * goes_on - values[t]
                advantages[t] = after = delta + args.gamma * args.gae_lambda * goes_on * after
            targets = advantages + values

        real = torch.nonzero(active.flatten() > 0).squeeze(-1)
        flat = [
            b.flatten(0, 1) for b in (seen_buffer, actions_buffer, logprobs, advantages, targets)
        ]
        for _ in range(args.epochs):
            for rows in real[torch.randperm(len(real))].chunk(args.minibatches):
                b_seen, b_action, b_logprob, b_advantage, b_target = (b[rows] for b in flat)
                _, logprob, entropy, value = agent(b_seen, b_action)
                b_advantage = (b_advantage - b_advantage.mean()) / (b_advantage.std() + 1e-8)
                ratio = (logprob - b_logprob).exp()
                clipped = ratio.clamp(1 - args.clip, 1 + args.clip)
                policy_loss = -torch.min(ratio * b_advantage, clipped * b_advantage).mean()
                value_loss = 0.5 * (value - b_target).pow(2).mean()
                loss = policy_loss + 0.5 * value_loss - args.entropy * entropy.mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        mean = f"{np.mean(returns[-20:]):8.1f}" if returns else "       -"
        print(f"steps {steps:8d}  return {mean}  steps/s {steps / (time.time() - begun):6.0f}")
    envs.close()
    driver = Driver.of_policy(agent.drive, view="racing", name="PPO")
    (row,) = run_race([driver], track=args.track, seed=args.seed, max_steps=900).agents
    finish = "not finished" if row.finish_time is None else f"finished in {row.finish_time:.1f} s"
    print(f"alone, from the grid: {row.distance:.0f} m, {finish}")


if __name__ == "__main__":
    main()
