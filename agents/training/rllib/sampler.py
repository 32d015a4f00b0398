"""Drives the races of an env runner, and records the steps of the learner's karts. Needs no Ray."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from stkzoo import RaceVectorEnv
from stkzoo.agents.pretrained.mlp import MlpDriver, log_probability_of, sample_choices
from stkzoo.wrappers.racing import CHOICES

from .races import RLlibArguments, win_share

FloatArray = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.intp]

_FLAGS = "is_terminated", "is_truncated"
#: Stable-Baselines3's names of the layers of RLlib's module.
_LAYERS = {
    "encoder.actor_encoder.net.mlp.": "mlp_extractor.policy_net.",
    "encoder.critic_encoder.net.mlp.": "mlp_extractor.value_net.",
    "pi.net.mlp.0.": "action_net.",
    "vf.net.mlp.0.": "value_net.",
}


@dataclass(frozen=True, slots=True)
class Fragment:
    """Consecutive steps of one kart in one race.

    Attributes:
        slot: number of the kart among those of all races.
        begin: number of the first step since the start of the race.
        observations: ``(T + 1, F)``; the last one follows the last step.
        actions: ``(T, 5)``.
        rewards: ``(T,)``.
        logits: ``(T, 31)`` of the policy that acted.
        log_probabilities: ``(T,)`` of the actions.
        is_terminated: whether the kart finished in the last step.
        is_truncated: whether the race was truncated after the last step.
    """

    slot: int
    begin: int
    observations: FloatArray
    actions: IntArray
    rewards: FloatArray
    logits: FloatArray
    log_probabilities: FloatArray
    is_terminated: bool
    is_truncated: bool

    def __len__(self) -> int:
        return len(self.rewards)


def cut_episodes(
    steps: Sequence[Mapping[str, npt.NDArray[Any]]], slots: IntArray
) -> list[Fragment]:
    """Cuts the steps of some slots into episodes; idle steps are left out.

    Args:
        steps: arrays over all slots for each step: the fields of :class:`Fragment`, ``active``, and
            ``after``, the observations that follow the step.
        slots: numbers of the slots.
    """
    arrays = {name: np.stack([step[name] for step in steps]) for name in steps[0]}
    active, after = arrays.pop("active"), arrays.pop("after")
    ended = arrays["is_terminated"] | arrays["is_truncated"]
    fragments = []
    for slot in slots.tolist():
        made = np.flatnonzero(active[:, slot])
        for part in np.split(made, np.flatnonzero(ended[made, slot]) + 1):
            if len(part):
                own = {name: array[part, slot] for name, array in arrays.items()}
                last = after[part[-1], slot]
                own["observations"] = np.concatenate([own["observations"], last[None]])
                flags = {name: bool(own.pop(name)[-1]) for name in _FLAGS}
                begin = int(own.pop("begin")[0])
                # The arrays are named as the fields, which the type of a dict cannot express.
                fragments.append(Fragment(slot, begin, **own, **flags))  # type: ignore[arg-type]
    return fragments


class SampledRace(NamedTuple):
    """Result of a race that a sampler drove.

    Attributes:
        reward: sum of the rewards of the learner's karts.
        win_share: see :func:`~stkzoo.agents.training.rllib.races.win_share`.
    """

    reward: float
    win_share: float | None


class RaceSampler:
    """Drives all races of an env runner at once: one network call for each module and step.

    Args:
        races: the races, whose agents are the learner's karts and its past selves.
        arguments: arguments of the run.
        seed: seed of the races and of the actions; ``None`` is random.

    Attributes:
        results: results of the races that ended since the caller last emptied the list. Races that
            crashed have none.
    """

    def __init__(
        self,
        races: RaceVectorEnv,
        arguments: RLlibArguments,
        seed: int | Sequence[int] | None = None,
    ) -> None:
        self.results: list[SampledRace] = []
        self._races, self._arguments = races, arguments
        self._random = np.random.default_rng(seed)
        self._networks: dict[str, MlpDriver] = {}
        agents = races.num_agents
        self._is_own = np.arange(races.num_envs) % agents < arguments.learners
        self._modules = np.empty(races.num_envs, object)
        self._positions = np.zeros(races.num_envs, np.intp)
        self._returns = np.zeros(races.num_envs)
        self._ages = np.zeros(races.num_envs, np.intp)
        self._racing: BoolArray = np.zeros(races.num_envs, np.bool_)
        self._observations: FloatArray = np.zeros((0, 0), np.float32)

    def load(self, networks: Mapping[str, MlpDriver]) -> None:
        """Replaces the networks of some modules, from the next step on."""
        self._networks.update(networks)

    def sample(self, kart_steps: int) -> list[Fragment]:
        """Drives until the learner's karts have made a number of steps; returns these steps.

        Episodes that continue are cut; the next call returns the rest of them.

        Args:
            kart_steps: minimum number of steps of the learner's karts, in total.
        """
        if not len(self._observations):
            self._start()
        steps: list[dict[str, npt.NDArray[Any]]] = []
        count = 0
        while count < kart_steps:
            steps.append(self._step())
            count += int((steps[-1]["active"] & self._is_own).sum())
        return cut_episodes(steps, np.flatnonzero(self._is_own))

    def _start(self) -> None:
        count = self._races.num_races
        seeds = self._random.integers(2**31, size=count).tolist()
        self._observations = self._races.reset_slots(seeds, [None] * count).observations
        for race in range(count):
            self._begin(race)
        self._racing = self._races.racing

    def _step(self) -> dict[str, npt.NDArray[Any]]:
        """Makes one step of all races, and returns its arrays; see :func:`cut_episodes`."""
        logits, seen = self._logits(), self._observations
        actions = sample_choices(logits, self._random)
        self._races.step_async(actions)
        log_probabilities = log_probability_of(actions, logits)  # while the races run
        steps = self._races.wait_slots()
        self._observations, after = steps.observations, steps.observations.copy()
        for slot, (observation, info) in steps.finals.items():
            after[slot], self._positions[slot] = observation, info["position"]
        begin = self._ages.copy()
        self._ages += steps.active
        self._returns += steps.rewards
        self._end_races(steps)
        return {
            "active": steps.active,
            "begin": begin,
            "observations": seen,
            "after": after,
            "actions": actions,
            "rewards": steps.rewards.astype(np.float32),
            "logits": logits,
            "log_probabilities": log_probabilities,
            "is_terminated": steps.terminations,
            "is_truncated": steps.truncations,
        }

    def _end_races(self, steps: Any) -> None:
        """Adds the results of the races that ended in a step, and begins the next ones."""
        left = self._by_race(self._racing & ~(steps.terminations | steps.truncations))
        for race in np.flatnonzero(~left.any(axis=1)).tolist():
            if not self._by_race(steps.crashed)[race].any():
                self.results.append(self._result(race))
            self._begin(race)
        self._racing = self._races.racing

    def _logits(self) -> FloatArray:
        """Returns the logits of all karts; zeros for idle ones."""
        logits = np.zeros((len(self._racing), sum(CHOICES)), np.float32)
        for module, network in self._networks.items():
            rows = np.flatnonzero((self._modules == module) & self._racing)
            if len(rows):
                logits[rows] = network.logits(self._observations[rows])
        return logits

    def _result(self, race: int) -> SampledRace:
        own = self._by_race(self._is_own)[race]
        positions = self._by_race(self._positions)[race]
        return SampledRace(
            reward=float(self._by_race(self._returns)[race][own].sum()),
            win_share=win_share(positions[own].tolist(), positions[~own].tolist()),
        )

    def _begin(self, race: int) -> None:
        """Draws the past selves of a new race and resets its sums."""
        number = int(self._random.integers(self._arguments.slots))
        self._by_race(self._modules)[race] = self._arguments.modules_of(number)
        self._by_race(self._ages)[race] = 0
        self._by_race(self._returns)[race] = 0.0

    def _by_race(self, array: Any) -> Any:
        """Returns an array over slots as ``(races, agents)``, without a copy."""
        return array.reshape(self._races.num_races, -1)


def sb3_names(state: Mapping[str, npt.NDArray[np.float32]]) -> dict[str, npt.NDArray[np.float32]]:
    """Returns the weights of RLlib's module under Stable-Baselines3's names."""
    return {
        theirs + name.removeprefix(ours): array
        for name, array in state.items()
        for ours, theirs in _LAYERS.items()
        if name.startswith(ours)
    }
