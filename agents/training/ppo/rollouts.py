"""Rollouts of PPO, and the actors that drive them in separate processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import CHOICE_NAMES, CHOICES, INPUT_SIZE, PolicyInput
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.policy import Network, RacingPolicy
from stkzoo.errors import ConfigError

from ..common.actors import SharedArray
from ..common.fleet import Finish, Fleet, FleetStep
from ..common.learner import RolloutResult, Weights
from ..common.ppo import FIELDS, VALUE_UNIT
from ..common.starts import Lineup

NUM_LOGITS = sum(CHOICES)
#: Element type of a rollout, an array ``(T, S)`` over steps and slots.
ROLLOUT = np.dtype(
    [
        ("inputs", np.float32, INPUT_SIZE),
        ("prior", np.float32, NUM_LOGITS),
        ("choices", np.int64, len(CHOICES)),
        *FIELDS,
    ],
    align=True,
)


def predict_values(critic: Network, inputs: FloatArray) -> FloatArray:
    """Returns the values of inputs ``(B, F)``."""
    values: FloatArray = critic(inputs)[:, 0] * np.float32(VALUE_UNIT)
    return values


def choice_columns(names: Sequence[str]) -> list[int]:
    """Returns the columns of choices by name.

    Raises:
        ConfigError: a name is unknown, or there is none.
    """
    unknown = sorted(set(names) - set(CHOICE_NAMES))
    if unknown or not names:
        raise ConfigError(f"learns is {list(names)}; expected some of {', '.join(CHOICE_NAMES)}")
    return sorted(CHOICE_NAMES.index(name) for name in set(names))


@dataclass(frozen=True, slots=True)
class ActorArguments:
    """Arguments of an actor.

    Attributes:
        lineups: lineup of each of its races.
        tracks: tracks of the races.
        place_reward: reward per place; the reward per meter is 0.05.
        rules: parameters of the plans.
        learns: names of the choices to sample; the others are the most likely ones.
    """

    lineups: tuple[Lineup, ...]
    tracks: tuple[str, ...]
    place_reward: float
    rules: DriverParameters
    learns: tuple[str, ...]

    @property
    def num_slots(self) -> int:
        """Number of learners in its races."""
        return sum(lineup.learners for lineup in self.lineups)


class RaceActor:
    """Drives some races with the learner's policy.

    Args:
        arguments: see :class:`ActorArguments`.
        memory: ``(2, T, S)`` of :data:`ROLLOUT`, two rollouts to fill in turn.
    """

    def __init__(self, arguments: ActorArguments, memory: SharedArray) -> None:
        self._rollouts = memory.array()
        self._columns = choice_columns(arguments.learns)
        self._fleet = Fleet(
            arguments.lineups,
            arguments.tracks,
            place_reward=arguments.place_reward,
            rules=arguments.rules,
        )

    def begin(self, seed: Sequence[int]) -> None:
        """Starts new races."""
        self._random = np.random.default_rng(seed)
        self._view = self._fleet.begin(seed)

    def drive(self, number: int, policy: Weights, critic: Weights) -> RolloutResult:
        """Fills a rollout.

        Args:
            number: number of the rollout, 0 or 1.
            policy: weights of the policy.
            critic: weights of the value network.
        """
        rollout, actor = self._rollouts[number], RacingPolicy(policy)
        value_network = Network(critic)
        finishes: list[Finish] = []
        for step in rollout:
            view = self._view
            choices, log_probability = self._choose(view, actor)
            step["driven"] = self._fleet.send(choices)
            step["choices"], step["log_probability"] = choices, log_probability
            step["inputs"], step["prior"] = view.inputs, view.prior
            step["values"] = predict_values(value_network, view.inputs)
            self._view, outcome = self._fleet.receive()
            outcome = self._own_outcome(outcome)
            step["rewards"], step["active"] = outcome.rewards, outcome.active
            step["ended"] = outcome.ended
            finishes += outcome.finishes
            if outcome.ended.any():
                last = predict_values(value_network, outcome.last_inputs[outcome.ended])
                step["next_values"][outcome.ended] = last
        return RolloutResult(predict_values(value_network, self._view.inputs), finishes)

    def close(self) -> None:
        """Ends all races."""
        self._fleet.close()

    def _choose(self, view: PolicyInput, actor: RacingPolicy) -> tuple[IntArray, FloatArray]:
        """Returns the choices of the karts and their log-probabilities."""
        return actor.sample(view, self._random, self._columns)

    def _own_outcome(self, outcome: FleetStep) -> FleetStep:
        """Returns the part of a step's outcome that is used for training."""
        return outcome
