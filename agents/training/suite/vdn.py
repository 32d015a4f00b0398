"""Value decomposition: Q-learning in which the value of a team is the sum over its karts.

    stkzoo suite train team-2v2 vdn

The sum is learned from the team's rewards (VDN; Sunehag et al., 2018); without teams, each kart is
a team of its own. A kart makes five choices. The value of its action is that of its observation
minus what each choice loses against the best one (dueling branches; Tavakoli et al., 2018):

    Q(o, c) = V(o) - sum over i of (max A_i(o) - A_i(o, c_i))

V is therefore the value of the best choices. There is no replay memory: the networks learn from
each rollout as PPO's do, towards Q(lambda) returns, as parallelized Q-networks (Gallici et al.,
2025). Choices are drawn by Boltzmann exploration: softmax of A over a temperature that decays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.arrays import FloatArray, IntArray
from stkzoo.agents.pretrained.mlp import SPLITS, sample_choices
from stkzoo.wrappers.racing import CHOICES

from ..common.actors import ActorPool
from ..common.arguments import NetworkArguments
from ..common.learner import Weights
from ..common.network_policy import FIRST_BIASES
from ..common.ppo import VALUE_UNIT, advantages_of
from .actor import TaskActor, TaskRollout
from .learner import TaskArguments, TaskLearner, run_task
from .network import TaskNetwork


@dataclass(frozen=True, slots=True)
class VDNArguments(TaskArguments, NetworkArguments):
    """Arguments of a run.

    Attributes:
        gamma: discount factor per step.
        td_lambda: lambda of the returns.
        temperature: initial temperature of the exploration, in units of rewards.
        final_temperature: its value at the end; it decays exponentially.
    """

    may_be_zero = TaskArguments.may_be_zero

    learning_rate: float = 5e-4
    batch_size: int = 1024
    gamma: float = 0.98
    td_lambda: float = 0.9
    temperature: float = 0.1
    final_temperature: float = 0.01


class ExploringActor(TaskActor):
    """Drives races of a task by Boltzmann exploration."""

    def drive(
        self,
        number: int,
        policy: Weights,
        critic: Weights,
        temperature: float = 1.0,
        preference: float = 0.0,
    ) -> TaskRollout:
        """Fills a rollout.

        Args:
            number: number of the rollout, 0 or 1.
            policy: weights of the policy.
            critic: weights of the value network.
            temperature: temperature by which the logits are divided.
            preference: weight of the preferences of every first policy.
        """
        self._temperature, self._preferences = temperature, preference * _first_logits()
        return super().drive(number, policy, critic)

    def _choose(self, logits: FloatArray) -> IntArray:
        return sample_choices(logits / self._temperature + self._preferences, self._random)


def _first_logits() -> FloatArray:
    """Returns logits of random choices, with the preferences of every first policy."""
    logits = np.zeros(sum(CHOICES), np.float32)
    logits[list(FIRST_BIASES)] = list(FIRST_BIASES.values())
    return logits


class VDNNetwork(TaskNetwork):
    """The networks: the logits of the policy are A, and the value network is V."""

    has_first_biases = False

    def values(self, inputs: Any, choices: Any) -> Any:
        """Returns Q ``(N,)`` of choices ``(N, 5)`` for inputs ``(N, F)``."""
        found = VALUE_UNIT * self.value(inputs)[:, 0]
        for number, part in enumerate(self.policy(inputs).tensor_split(SPLITS, dim=1)):
            chosen = part.gather(1, choices[:, number : number + 1])[:, 0]
            found = found - (part.max(dim=1).values - chosen)
        return found


class VDN(TaskLearner):
    """A run of value decomposition; see :class:`.learner.TaskLearner`."""

    arguments: VDNArguments
    _network: VDNNetwork
    shown = (*TaskLearner.shown, "temperature", "loss", "explained")

    @classmethod
    def arguments_of(cls, task: str, kart_steps: int, seed: int) -> VDNArguments:
        """See :meth:`.learner.TaskLearner.arguments_of`."""
        return VDNArguments(algorithm="vdn", task=task, seed=seed, anneal_timesteps=kart_steps)

    def _new_network(self) -> VDNNetwork:
        return VDNNetwork(self.arguments.hidden, self.arguments.seed)

    def _new_actors(self, arguments: list[tuple[Any, ...]]) -> ActorPool:
        return ActorPool(ExploringActor, arguments)

    def _drive_options(self) -> tuple[Any, ...]:
        return self._temperature(), self._left()

    def _left(self) -> float:
        """Returns the share of the run that is left."""
        return max(1.0 - self.kart_steps / self.arguments.anneal_timesteps, 0.0)

    def _temperature(self) -> float:
        first, last = self.arguments.temperature, self.arguments.final_temperature
        return float(last * (first / last) ** self._left())

    def _update(
        self, rollouts: Sequence[npt.NDArray[np.void]], driven: Sequence[Any]
    ) -> dict[str, float]:
        """Runs several epochs of gradient steps on the teams' moments in the rollouts."""
        given, torch = self.arguments, self._network.torch
        rate = given.learning_rate * max(self._left(), 0.05)
        for group in self._network.optimiser.param_groups:
            group["lr"] = rate
        seen = np.concatenate(rollouts, axis=1)
        gained = [
            advantages_of(rollout, own.last_values, given.gamma, given.td_lambda)
            for rollout, own in zip(rollouts, driven, strict=True)
        ]
        targets = np.concatenate(gained, axis=1) + seen["values"]
        members = team_slots(seen.shape[1], self.task.learners, self.task.teams)
        # moments of teams, with a member that still races, by step and slot of each member
        rows = [column[:, members].reshape(-1, members.shape[1]) for column in (seen, targets)]
        is_racing = rows[0]["active"].any(axis=1)
        moments, targets = rows[0][is_racing], torch.from_numpy(rows[1][is_racing])
        parts = [torch.from_numpy(moments[name].copy()) for name in ("inputs", "choices", "active")]
        losses = [
            self._gradient_step(*(part[batch] for part in (*parts, targets)))
            for _ in range(given.n_epochs)
            for batch in torch.from_numpy(self._random.permutation(len(moments))).split(
                given.batch_size
            )
        ]
        active = seen["active"]
        unexplained = np.var((rows[1] - rows[0]["values"])[rows[0]["active"]])
        return {
            "loss": float(np.mean(losses)),
            "temperature": self._temperature(),
            "learning_rate": rate,
            "explained": float(1 - unexplained / max(np.var(rows[1][rows[0]["active"]]), 1e-9)),
            "reward": float(seen["rewards"].sum() / max(active.sum(), 1)),
        }

    def _gradient_step(self, inputs: Any, choices: Any, active: Any, targets: Any) -> float:
        """Makes a gradient step on moments of teams, ``(B, M, ...)``; returns the loss."""
        nets = self._network
        values = nets.values(inputs.flatten(0, 1), choices.flatten(0, 1)).view(targets.shape)
        errors = ((values - targets) * active).sum(1) / VALUE_UNIT
        loss = errors.square().mean()
        nets.optimiser.zero_grad()
        loss.backward()
        for layers in (nets.policy, nets.value):
            nets.torch.nn.utils.clip_grad_norm_(layers.parameters(), 0.5)
        nets.optimiser.step()
        return float(loss.detach())


def team_slots(num_slots: int, learners: int, teams: Sequence[Sequence[int]]) -> IntArray:
    """Returns the slots of the members of each team of each race, ``(G, M)``.

    Args:
        num_slots: number of slots of all races.
        learners: number of learners of a race.
        teams: their teams; without any, each learner is one.
    """
    own = np.array(teams or [[agent] for agent in range(learners)])
    firsts = np.arange(0, num_slots, learners)
    slots: IntArray = (firsts[:, None, None] + own).reshape(-1, own.shape[1])
    return slots


run = partial(run_task, VDN)
