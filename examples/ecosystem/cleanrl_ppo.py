"""PPO with shared parameters in one file, in the style of CleanRL, with PyTorch only.

python examples/ecosystem/cleanrl_ppo.py --total-steps 1000000
"""

import argparse
import time

import numpy as np
import torch
from torch import nn
from torch.distributions import Categorical

import stkzoo


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--total-steps", type=int, default=1200, help="of all agents together")
    parser.add_argument("--races", type=int, default=2)
    parser.add_argument("--karts", type=int, default=3, help="in each race, all of them agents")
    parser.add_argument("--track", default="lighthouse")
    parser.add_argument("--horizon", type=int, default=64)
    parser.add_argument("--minibatches", type=int, default=4)
    parser.add_argument("--epochs", type=int, default=4)
    parser.add_argument("--learning-rate", type=float, default=2.5e-4)
    parser.add_argument("--gamma", type=float, default=0.99)
    parser.add_argument("--gae-lambda", type=float, default=0.95)
    parser.add_argument("--clip", type=float, default=0.2)
    parser.add_argument("--entropy", type=float, default=0.01)
    return parser.parse_args()


def layer(inputs: int, outputs: int, std: float = 2**0.5) -> nn.Linear:
    linear = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(linear.weight, std)
    nn.init.zeros_(linear.bias)
    return linear


class Agent(nn.Module):
    """An actor and a critic; masked actions are never sampled."""

    def __init__(self, size: int, actions: int) -> None:
        super().__init__()
        self.critic = nn.Sequential(
            layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, 1, 1.0)
        )
        self.actor = nn.Sequential(
            layer(size, 64), nn.Tanh(), layer(64, 64), nn.Tanh(), layer(64, actions, 0.01)
        )

    def forward(self, seen, mask, action=None):
        seen = torch.sign(seen) * torch.log1p(seen.abs())  # compresses large distances and times
        logits = self.actor(seen).masked_fill(mask == 0, -1e8)
        choice = Categorical(logits=logits)
        action = choice.sample() if action is None else action
        return action, choice.log_prob(action), choice.entropy(), self.critic(seen).squeeze(-1)


def main() -> None:
    args = arguments()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)  # small networks; leave the cores to the races
    envs = stkzoo.RaceVectorEnv(
        args.races, num_kart=args.karts, track=args.track, view="masked_discrete"
    )
    slots, size = envs.num_envs, envs.single_observation_space["observation"].shape[0]
    count = int(envs.single_action_space.n)
    agent = Agent(size, count)
    optimizer = torch.optim.Adam(agent.parameters(), lr=args.learning_rate, eps=1e-5)

    shape = (args.horizon, slots)
    seen_buffer = torch.zeros((*shape, size))
    mask_buffer = torch.zeros((*shape, count), dtype=torch.int8)
    actions_buffer = torch.zeros(shape, dtype=torch.long)
    logprobs, rewards, dones, values, active = (torch.zeros(shape) for _ in range(5))

    def tensors(observations):
        return torch.as_tensor(observations["observation"]), torch.as_tensor(
            observations["action_mask"]
        )

    seen, mask = tensors(envs.reset(seed=args.seed)[0])
    begun, steps, returns = time.time(), 0, []
    while steps < args.total_steps:
        for t in range(args.horizon):
            seen_buffer[t], mask_buffer[t] = seen, mask
            with torch.no_grad():
                action, logprobs[t], _, values[t] = agent(seen, mask)
            actions_buffer[t] = action
            observations, reward, terminated, truncated, infos = envs.step(action.numpy())
            rewards[t] = torch.as_tensor(reward / 10)
            if truncated.any():  # an episode cut short: its last state still has a value
                last = [infos["final_obs"][slot] for slot in truncated.nonzero()[0]]
                final = {name: np.stack([each[name] for each in last]) for name in last[0]}
                with torch.no_grad():
                    rewards[t, truncated] += args.gamma * agent(*tensors(final))[3]
            dones[t] = torch.as_tensor(terminated | truncated)
            active[t] = torch.as_tensor(infos["active"])  # finished agents have no transitions
            seen, mask = tensors(observations)
            steps += int(infos["active"].sum())
            if "final_info" in infos:
                returns.extend(infos["final_info"]["episode"]["r"][infos["_final_info"]])

        with torch.no_grad():
            last_value = agent(seen, mask)[3]
            advantages, after = torch.zeros(shape), torch.zeros(slots)
            for t in reversed(range(args.horizon)):
                next_value = values[t + 1] if t + 1 < args.horizon else last_value
                goes_on = 1 - dones[t]
                delta = rewards[t] + args.gamma * next_value * goes_on - values[t]
                advantages[t] = after = delta + args.gamma * args.gae_lambda * goes_on * after
            targets = advantages + values

        real = torch.nonzero(active.flatten() > 0).squeeze(-1)
        flat = [
            b.flatten(0, 1)
            for b in (seen_buffer, mask_buffer, actions_buffer, logprobs, advantages, targets)
        ]
        for _ in range(args.epochs):
            for rows in real[torch.randperm(len(real))].chunk(args.minibatches):
                b_seen, b_mask, b_action, b_logprob, b_advantage, b_target = (b[rows] for b in flat)
                _, logprob, entropy, value = agent(b_seen, b_mask, b_action)
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


if __name__ == "__main__":
    main()
