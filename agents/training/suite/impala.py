"""V-trace, the actor-critic of IMPALA: importance weights correct for the age of the rollouts.

    stkzoo suite train versus impala

Like independent PPO (:mod:`.algorithms`), but with another update: one pass over the rollouts,
without a limit on the change of the policy. Older policies drove the rollouts. Importance weights,
clipped at 1, correct the value targets and the policy gradient for that (Espeholt et al., 2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..common.learner import FloatArray, RolloutResult
from ..common.ppo import VALUE_UNIT
from .learner import TaskArguments, TaskLearner


class IMPALA(TaskLearner):
    """A run of V-trace; see :class:`.learner.TaskLearner`.

    A batch contains whole rollouts of some learners. ``gae_lambda`` is the lambda of V-trace.
    """

    @classmethod
    def arguments_of(cls, task: str, kart_steps: int, seed: int) -> TaskArguments:
        """See :meth:`.learner.TaskLearner.arguments_of`."""
        return replace(super().arguments_of(task, kart_steps, seed), n_epochs=1, batch_size=512)

    def _update(
        self, rollouts: Sequence[npt.NDArray[np.void]], driven: Sequence[RolloutResult]
    ) -> dict[str, float]:
        """Makes gradient steps on the rollouts."""
        settings = self.arguments
        rate, ent_coef = self._anneal()
        rollout = np.concatenate(rollouts, axis=1)
        last_values = np.concatenate([own.last_values for own in driven])
        counted = (rollout["active"] & rollout["driven"]).sum(axis=0)
        size = max(settings.batch_size // settings.n_steps, 1)
        figures: dict[str, list[float]] = {}
        for _ in range(settings.n_epochs):
            order = self._random.permutation(np.flatnonzero(counted))
            for begin in range(0, len(order), size):
                slots = order[begin : begin + size]
                if counted[slots].sum() > 1:  # the spread of one advantage is undefined
                    found = self._step_on(rollout[:, slots], last_values[slots], ent_coef)
                    for name, value in found.items():
                        figures.setdefault(name, []).append(value)
        means = {name: float(np.mean(values)) for name, values in figures.items()}
        return {**means, "learning_rate": rate}

    def _step_on(
        self, rollout: npt.NDArray[np.void], last_values: FloatArray, ent_coef: float
    ) -> dict[str, float]:
        """Makes a gradient step on a rollout ``(T, S)``."""
        nets, settings = self._network, self.arguments
        from_numpy = nets.torch.from_numpy
        rows = rollout.reshape(-1)
        log_probability, entropy, _, values = nets.evaluate(nets.tensors(rows))
        log_ratio = log_probability - from_numpy(rows["log_probability"].copy())
        ratios = log_ratio.detach().exp().numpy().reshape(rollout.shape)
        own = values.detach().numpy().reshape(rollout.shape) * np.float32(VALUE_UNIT)
        targets, advantages = vtrace(
            rollout, own, ratios, last_values, settings.gamma, settings.gae_lambda
        )
        counted = from_numpy((rollout["active"] & rollout["driven"]).reshape(-1))
        gained = from_numpy(advantages.reshape(-1))[counted]
        gained = (gained - gained.mean()) / (gained.std() + 1e-6)
        errors = (values - from_numpy(targets.reshape(-1) / VALUE_UNIT))[counted]
        value_loss, entropy = errors.square().mean(), entropy[counted].mean()
        objective = (log_probability[counted] * gained).mean()
        nets.descend(value_loss - objective - ent_coef * entropy)
        with nets.torch.no_grad():
            scale = max(float(np.var(targets[rollout["active"]])) / VALUE_UNIT**2, 1e-9)
            return {
                "kl": float((log_ratio.exp() - 1 - log_ratio)[counted].mean()),
                "entropy": float(entropy),
                "value_loss": float(value_loss),
                "explained": 1.0 - float(errors.var()) / scale,
            }


def vtrace(
    rollout: npt.NDArray[np.void],
    values: FloatArray,
    ratios: FloatArray,
    last_values: FloatArray,
    gamma: float,
    trace: float,
) -> tuple[FloatArray, FloatArray]:
    """Returns targets of the values and advantages of the policy, both ``(T, S)`` float32.

    With ratios of 1, the targets are those of GAE, and with ``trace`` = 1 the returns.

    Args:
        rollout: ``(T, S)`` of :func:`.actor.rollout_type`; ended races are bootstrapped.
        values: ``(T, S)`` values.
        ratios: ``(T, S)`` probability of each action over its probability when it was chosen.
        last_values: ``(S,)`` values after the last step.
        gamma: discount factor per step.
        trace: factor of the traces, from 0 to 1.
    """
    weights = np.minimum(ratios, 1.0)
    targets, advantages = np.zeros_like(values), np.zeros_like(values)
    next_values, next_targets = last_values, last_values
    for step in reversed(range(len(rollout))):
        ended, rewards = rollout["ended"][step], rollout["rewards"][step]
        after = rollout["next_values"][step]
        next_values = np.where(ended, after, next_values)
        next_targets = np.where(ended, after, next_targets)
        delta = rewards + gamma * next_values - values[step]
        later = gamma * trace * (next_targets - next_values)
        is_active = rollout["active"][step]
        targets[step] = values[step] + np.where(is_active, weights[step] * (delta + later), 0)
        gained = rewards + gamma * next_targets - values[step]
        advantages[step] = np.where(is_active, weights[step] * gained, 0)
        next_values, next_targets = values[step], targets[step]
    return targets, advantages
