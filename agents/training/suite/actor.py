"""Actors that drive the races of a task, and the rollouts that they fill."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import RaceVectorEnv
from stkzoo._schema import Place
from stkzoo.agents.planning import IntArray
from stkzoo.agents.pretrained.mlp import MlpDriver, log_probability_of, sample_choices
from stkzoo.agents.pretrained.policy import Network
from stkzoo.suite import Task
from stkzoo.wrappers.racing import CHOICES, SIZE

from ..common.actors import SharedArray
from ..common.learner import FloatArray, RolloutResult, Weights
from ..common.ppo import FIELDS, VALUE_UNIT


def rollout_type(state_size: int) -> np.dtype[np.void]:
    """Returns the element type of a rollout, an array ``(T, S)`` over steps and slots.

    Args:
        state_size: size of the race's state in it; 0 for none.
    """
    seen = [("inputs", np.float32, SIZE), ("state", np.float32, (state_size,))]
    return np.dtype([*seen, ("choices", np.int64, len(CHOICES)), *FIELDS], align=True)


def critic_inputs(rows: npt.NDArray[np.void]) -> FloatArray:
    """Returns the value network's inputs ``(N, SIZE + state_size)`` in rows of a rollout."""
    return np.concatenate([rows["inputs"], rows["state"]], axis=-1)


@dataclass(frozen=True, slots=True)
class KartRace:
    """The race of a learner's kart.

    Attributes:
        reward: sum of its rewards.
        is_finished: whether it finished.
        position: its position at the end; 1 is first.
    """

    reward: float
    is_finished: bool
    position: Place


class TaskActor:
    """Drives races of a task, whose learners share one policy.

    Args:
        options: arguments of :class:`~stkzoo.RaceVectorEnv`.
        shares: see :func:`reward_shares`.
        memory: ``(2, T, S)`` of :func:`rollout_type`, two rollouts to fill in turn.
    """

    def __init__(
        self, options: Mapping[str, Any], shares: npt.NDArray[np.float64], memory: SharedArray
    ) -> None:
        self._rollouts = memory.array()
        self._has_states = self._rollouts.dtype["state"].shape != (0,)
        self._races = RaceVectorEnv(**options)
        self._shares = shares
        self._returns = np.zeros(self._races.num_envs)
        self._is_own = np.ones(self._races.num_envs, np.bool_)  # slots that the policy drives

    def begin(self, seed: Sequence[int]) -> None:
        """Starts new races."""
        self._random = np.random.default_rng(seed)
        count = self._races.num_races
        seeds = self._random.integers(2**31, size=count).tolist()
        self._observations = self._races.reset_slots(seeds, [None] * count).observations
        self._returns[:] = 0.0

    def drive(self, number: int, policy: Weights, critic: Weights) -> RolloutResult:
        """Fills a rollout.

        Args:
            number: number of the rollout, 0 or 1.
            policy: weights of the policy.
            critic: weights of the value network.
        """
        network, values_of = MlpDriver(policy), Network(critic)
        ended: list[KartRace] = []
        for step in self._rollouts[number]:
            seen = self._observations
            step["state"] = self._states()
            logits = network.logits(seen)
            choices = self._choose(logits)
            self._races.step_async(choices)
            step["inputs"], step["choices"] = seen, choices  # while the races run
            step["log_probability"] = log_probability_of(choices, logits)
            step["values"] = values_of(critic_inputs(step))[:, 0] * VALUE_UNIT
            steps = self._races.wait_slots()
            step["rewards"] = np.where(steps.active, self._shared(steps.rewards), 0.0)
            step["active"] = step["driven"] = steps.active & self._is_own
            step["ended"] = steps.terminations | steps.truncations
            step["next_values"] = 0.0
            self._returns += step["rewards"]
            for slot, (last, info) in steps.finals.items():
                if steps.truncations[slot]:
                    # The race has been reset, so the state is the one before the step.
                    row = np.concatenate([last, step["state"][slot]])
                    step["next_values"][slot] = values_of(row[None])[0, 0] * VALUE_UNIT
                if self._is_own[slot]:
                    ended.append(
                        KartRace(
                            reward=float(self._returns[slot]),
                            is_finished=bool(steps.terminations[slot]),
                            position=int(info["position"]),
                        )
                    )
                self._returns[slot] = 0.0
            self._look_at(steps.finals)
            self._observations = steps.observations
        latest = np.concatenate([self._observations, self._states()], axis=1)
        return RolloutResult(values_of(latest)[:, 0] * np.float32(VALUE_UNIT), ended)

    def close(self) -> None:
        """Ends all races."""
        self._races.close()

    def _choose(self, logits: FloatArray) -> IntArray:
        """Returns the choices ``(S, 5)`` of all slots for the logits ``(S, 31)`` of the policy."""
        return sample_choices(logits, self._random)

    def _look_at(self, finals: Mapping[int, tuple[Any, dict[str, Any]]]) -> None:
        """Called after each step with the slots that ended."""

    def _states(self) -> FloatArray:
        """Returns the state of each slot's race, ``(S, state_size)``."""
        if not self._has_states:
            return np.zeros((self._races.num_envs, 0), np.float32)
        states = [race.state() for race in self._races.races]
        return np.repeat(np.stack(states), self._races.num_agents, axis=0)

    def _shared(self, rewards: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns the rewards of all slots after the members of teams have shared theirs."""
        by_race = rewards.reshape(self._races.num_races, -1)
        shared: npt.NDArray[np.float64] = (by_race @ self._shares).reshape(-1)
        return shared


def reward_shares(task: Task) -> npt.NDArray[np.float64]:
    """Returns the share of each agent's reward that each agent gets, ``(A, A)``.

    As :class:`~stkzoo.wrappers.marl.Teams` does with ``share=1``, every member gets the mean over
    its team; members that have left count as 0.

    Args:
        task: the task.
    """
    shares = np.eye(task.learners)
    for team in task.teams:
        shares[np.ix_(team, team)] = 1 / len(team)
    return shares
