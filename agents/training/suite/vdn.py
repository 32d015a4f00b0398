"""Value decomposition: Q-learning in which the value of a team is the sum over its karts.

    stkzoo suite train team-2v2 vdn

The sum is learned from the team's rewards (VDN; Sunehag et al., 2018); without teams, each kart is
a team of its own. A kart makes five choices, and its value is that of its observation minus what
each choice loses against the best one (dueling branches; Tavakoli et al., 2018):

    Q(o, c) = V(o) - sum over i of (max A_i(o) - A_i(o, c_i))

V is therefore the value of the best choices. A target is the return over five steps plus the value,
by a copy of the networks that follows slowly, of the newest networks' best choices (double
Q-learning; van Hasselt et al., 2016). Each choice is random with a probability that decays.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo.agents.planning.arrays import FloatArray, IntArray
from stkzoo.agents.pretrained.mlp import SPLITS, likeliest, sample_choices
from stkzoo.wrappers.racing import CHOICES, SIZE

from ..common.actors import ActorPool
from ..common.arguments import NetworkArguments
from ..common.learner import Weights
from ..common.network_policy import FIRST_BIASES
from ..common.ppo import VALUE_UNIT
from .actor import TaskActor, TaskRollout
from .learner import TaskArguments, TaskLearner, run_task
from .network import TaskNetwork

#: Element type of the replay memory.
_KEPT = np.dtype(
    [
        ("inputs", np.float32, SIZE),
        ("choices", np.int64, len(CHOICES)),
        ("gain", np.float32),  # discounted return until the target's observation or the end
        ("goes_on", np.bool_),  # whether the race has not ended until then
        ("active", np.bool_),
    ]
)
_NETWORKS = ("policy", "value")


@dataclass(frozen=True, slots=True)
class VDNArguments(TaskArguments, NetworkArguments):
    """Arguments of a run.

    Attributes:
        gamma: discount factor per step.
        horizon: steps of the returns in targets.
        memory: number of rollouts in the replay memory.
        target_rate: share of the newest weights in the targets' after a gradient step.
        exploration_fraction: fraction of the run in which the exploration decays.
        final_exploration: final probability of each random choice.
    """

    may_be_zero = TaskArguments.may_be_zero

    batch_size: int = 512
    gamma: float = 0.98
    horizon: int = 5
    memory: int = 25
    target_rate: float = 0.01
    exploration_fraction: float = 0.3
    final_exploration: float = 0.02


class ExploringActor(TaskActor):
    """Drives races of a task by the best choices, and by random ones now and then."""

    def drive(
        self, number: int, policy: Weights, critic: Weights, exploration: float = 0.0
    ) -> TaskRollout:
        """Fills a rollout.

        Args:
            number: number of the rollout, 0 or 1.
            policy: weights of the policy.
            critic: weights of the value network.
            exploration: probability of each random choice.
        """
        self._exploration = exploration
        return super().drive(number, policy, critic)

    def _choose(self, logits: FloatArray) -> IntArray:
        best = likeliest(logits)
        random = sample_choices(np.tile(_first_logits(), (len(logits), 1)), self._random)
        return np.where(self._random.random(best.shape) < self._exploration, random, best)


def _first_logits() -> FloatArray:
    """Returns logits of random choices, with the preferences of every first policy."""
    logits = np.zeros(sum(CHOICES), np.float32)
    logits[list(FIRST_BIASES)] = list(FIRST_BIASES.values())
    return logits


class VDNNetwork(TaskNetwork):
    """The networks: the logits of the policy are A, the value network is V, in units of rewards.

    Args:
        hidden: units of the hidden layers of both.
        seed: seed of the initial weights.
    """

    has_first_biases = False

    def __init__(self, hidden: Sequence[int], seed: int) -> None:
        super().__init__(hidden, seed)
        self.targets = {name: copy.deepcopy(getattr(self, name)) for name in _NETWORKS}

    def state(self) -> dict[str, Any]:
        """See :class:`..common.ppo.PPONetwork`."""
        targets = {name: layers.state_dict() for name, layers in self.targets.items()}
        return {**super().state(), "targets": targets}

    def restore(self, state: dict[str, Any]) -> None:
        """See :class:`..common.ppo.PPONetwork`."""
        super().restore(state)
        for name, layers in self.targets.items():
            layers.load_state_dict(state["targets"][name])

    def follow(self, rate: float) -> None:
        """Moves the targets towards the newest weights."""
        for name, layers in self.targets.items():
            own, newest = list(layers.parameters()), list(getattr(self, name).parameters())
            with self.torch.no_grad():
                self.torch._foreach_lerp_(own, newest, rate)

    def values(self, inputs: Any, choices: Any, *, of_targets: bool = False) -> Any:
        """Returns Q in units of :data:`..common.ppo.VALUE_UNIT`.

        Args:
            inputs: ``(N, F)``.
            choices: ``(N, 5)``.
            of_targets: whether the targets are asked.

        Returns:
            A tensor ``(N,)``.
        """
        policy, value = (
            (self.targets["policy"], self.targets["value"])
            if of_targets
            else (self.policy, self.value)
        )
        found = value(inputs)[:, 0]
        for number, part in enumerate(policy(inputs).tensor_split(SPLITS, dim=1)):
            chosen = part.gather(1, choices[:, number : number + 1])[:, 0]
            found = found - (part.max(dim=1).values - chosen)
        return found

    def best(self, inputs: Any) -> Any:
        """Returns the best choices ``(N, 5)`` for inputs ``(N, F)``."""
        with self.torch.no_grad():
            parts = self.policy(inputs).tensor_split(SPLITS, dim=1)
            return self.torch.stack([part.argmax(dim=1) for part in parts], dim=1)


class VDN(TaskLearner):
    """A run of value decomposition; see :class:`.learner.TaskLearner`."""

    arguments: VDNArguments
    _network: VDNNetwork
    shown = (*TaskLearner.shown, "exploration", "loss", "value")

    @classmethod
    def arguments_of(cls, task: str, kart_steps: int, seed: int) -> VDNArguments:
        """See :meth:`.learner.TaskLearner.arguments_of`."""
        return VDNArguments(algorithm="vdn", task=task, seed=seed, anneal_timesteps=kart_steps)

    def _new_network(self) -> VDNNetwork:
        return VDNNetwork(self.arguments.hidden, self.arguments.seed)

    def _new_actors(self, arguments: list[tuple[Any, ...]]) -> ActorPool:
        return ActorPool(ExploringActor, arguments)

    def _drive_options(self) -> tuple[Any, ...]:
        return (self._exploration(),)

    def _exploration(self) -> float:
        given = self.arguments
        done = self.kart_steps / (given.exploration_fraction * given.anneal_timesteps)
        return 1.0 - min(done, 1.0) * (1.0 - given.final_exploration)

    # ------------------------------------------------------------------ replay memory

    def _remember(self, rollouts: Sequence[npt.NDArray[np.void]]) -> npt.NDArray[np.void]:
        """Adds a rollout of all actors to the replay memory, and returns what is known so far."""
        new = np.concatenate([kept_rows(own, self.arguments) for own in rollouts], axis=1)
        if not hasattr(self, "_memory"):
            self._memory = np.zeros((self.arguments.memory, *new.shape), _KEPT)
        self._memory[self.iteration % len(self._memory)] = new
        return self._memory[: min(self.iteration + 1, len(self._memory))]

    def _state(self) -> dict[str, Any]:
        flat = self._memory.view(np.uint8).reshape(*self._memory.shape, -1)
        return {**super()._state(), "memory": self._network.torch.from_numpy(flat)}

    def _restore_state(self, state: dict[str, Any]) -> None:
        super()._restore_state(state)
        self._memory = state["memory"].numpy().view(_KEPT)[..., 0]

    # ------------------------------------------------------------------ learning

    def _update(
        self, rollouts: Sequence[npt.NDArray[np.void]], _: Sequence[Any]
    ) -> dict[str, float]:
        """Makes as many gradient steps as pass ``n_epochs`` times over what is new."""
        given, memory = self.arguments, self._remember(rollouts)
        members = team_slots(memory.shape[2], self.task.learners, self.task.teams)
        ahead = given.n_steps - given.horizon
        seen = np.argwhere(memory["active"][:, :ahead][..., members].any(axis=-1))
        count = len(rollouts[0]) * len(members) * given.n_epochs // given.batch_size
        self._network.optimiser.param_groups[0]["lr"] = given.learning_rate
        self._network.optimiser.param_groups[1]["lr"] = given.learning_rate
        figures = [
            self._gradient_step(memory, members, seen[rows])
            for rows in self._random.integers(len(seen), size=(max(count, 1), given.batch_size))
        ]
        reward = sum(own["rewards"].sum() for own in rollouts)
        return {
            "loss": float(np.mean([loss for loss, _ in figures])),
            "value": float(np.mean([value for _, value in figures])) * VALUE_UNIT,
            "exploration": self._exploration(),
            "reward": float(reward / max(sum(own["active"].sum() for own in rollouts), 1)),
        }

    def _gradient_step(
        self, memory: npt.NDArray[np.void], members: IntArray, chosen: IntArray
    ) -> tuple[float, float]:
        """Makes a gradient step on moments of teams, ``(B, 3)``: rollout, step, team.

        Returns:
            The loss, and the mean value.
        """
        given, nets = self.arguments, self._network
        torch, size = nets.torch, members.shape[1]
        rollout, step, slots = chosen[:, :1], chosen[:, 1:2], members[chosen[:, 2]]
        now = memory[rollout, step, slots].reshape(-1)
        later = memory["inputs"][rollout, step + given.horizon, slots].reshape(-1, SIZE)
        active, goes_on, gain = (
            torch.from_numpy(now[name].astype(np.float32)) for name in ("active", "goes_on", "gain")
        )
        after = torch.from_numpy(later)
        values = nets.values(
            torch.from_numpy(now["inputs"].copy()), torch.from_numpy(now["choices"].copy())
        )
        with torch.no_grad():
            next_values = nets.values(after, nets.best(after), of_targets=True)
        targets = gain / VALUE_UNIT + given.gamma**given.horizon * goes_on * next_values
        sums = (values * active).view(-1, size).sum(1), (targets * active).view(-1, size).sum(1)
        loss = torch.nn.functional.smooth_l1_loss(*sums)
        nets.optimiser.zero_grad()
        loss.backward()
        for layers in (nets.policy, nets.value):
            torch.nn.utils.clip_grad_norm_(layers.parameters(), 0.5)
        nets.optimiser.step()
        nets.follow(given.target_rate)
        return float(loss.detach()), float(sums[0].detach().mean()) / size


def kept_rows(rollout: npt.NDArray[np.void], arguments: VDNArguments) -> npt.NDArray[np.void]:
    """Returns what the replay memory keeps of a rollout ``(T, S)``."""
    found = np.zeros(rollout.shape, _KEPT)
    for name in ("inputs", "choices", "active"):
        found[name] = rollout[name]
    gain, goes_on = np.zeros(rollout.shape, np.float32), np.ones(rollout.shape, np.bool_)
    steps = len(rollout) - arguments.horizon
    for ahead in range(arguments.horizon):
        step, factor = rollout[ahead : ahead + steps], arguments.gamma**ahead
        last = step["rewards"] + arguments.gamma * np.where(step["ended"], step["next_values"], 0)
        gain[:steps] += np.where(goes_on[:steps], factor * last, 0)
        goes_on[:steps] &= ~step["ended"]
    found["gain"], found["goes_on"] = gain, goes_on
    return found


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
