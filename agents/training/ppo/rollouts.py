"""Rollouts of PPO, and the actors that drive them in separate processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import RaceVectorEnv
from stkzoo._schema import Place
from stkzoo.agents.planning import FloatArray, IntArray
from stkzoo.agents.planning.driver import CHOICES as PLAN_CHOICES
from stkzoo.agents.planning.driver import INPUT_SIZE
from stkzoo.agents.planning.mirrored import MirroredRaces
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.planning.view import PlanVectorEnv
from stkzoo.agents.pretrained.mlp import MlpDriver, is_network
from stkzoo.agents.pretrained.policy import Network, log_sum
from stkzoo.agents.pretrained.recurrent import GatedUnit
from stkzoo.agents.pretrained.weights import load_weights
from stkzoo.wrappers.racing import CHOICES, PLACES, SIZE

from ..common.actors import SharedArray
from ..common.filtered import FilteredView
from ..common.matches import ai_time
from .opponents import Odds, RivalSeats, draw_opponent

Weights = Mapping[str, FloatArray]
BoolArray = npt.NDArray[np.bool_]

#: Columns of the views ``racing`` and ``contest`` with the kart's own state, and of its rank.
_OWN, _RANK = slice(0, PLACES["line_position"].start), SIZE
#: Share of the karts that observe and act with left and right swapped, with plans or a filter.
MIRROR_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class ActorRaces:
    """Races with the same options.

    Attributes:
        num_races: number of races.
        options: arguments of :class:`~stkzoo.RaceVectorEnv`.
        has_rivals: whether past selves drive some of the karts.
        teams: numbers of the agents of each team, who share their rewards; empty without teams.
    """

    num_races: int
    options: Mapping[str, Any]
    has_rivals: bool = False
    teams: tuple[tuple[int, ...], ...] = ()

    @property
    def num_agents(self) -> int:
        """Agents of each race."""
        agents = self.options["agents"]
        return agents if isinstance(agents, int) else len(agents)

    @property
    def company(self) -> str:
        """The opponents of the learners: ``"alone"`` for none, ``"selfplay"`` or ``"rivals"``."""
        if self.options["num_kart"] > self.num_agents:
            return "rivals"
        return "selfplay" if self.num_agents > 1 else "alone"


def dealt(groups: Sequence[ActorRaces], count: int) -> list[tuple[ActorRaces, ...]]:
    """Deals the races of groups to ``count`` actors, one by one."""
    numbers = [n for n, group in enumerate(groups) for _ in range(group.num_races)]
    hands = [numbers[actor::count] for actor in range(count)]
    return [
        tuple(replace(groups[n], num_races=hand.count(n)) for n in dict.fromkeys(hand))
        for hand in hands
    ]


@dataclass(frozen=True, slots=True)
class PolicyShape:
    """What a policy sees and chooses.

    Attributes:
        inputs: number of its inputs.
        choices: number of options of each choice.
        columns: choices to sample; the others are the most likely ones and count as certain.
        has_prior: whether its logits are added to a prior.
        state_size: size of the race's state, which the value network sees too; 0 for none.
        memory_size: size of the memory of a recurrent policy, its last inputs; 0 without one.
    """

    inputs: int
    choices: tuple[int, ...]
    columns: tuple[int, ...]
    has_prior: bool = False
    state_size: int = 0
    memory_size: int = 0

    @property
    def heads(self) -> tuple[slice, ...]:
        """Slice of each choice's logits."""
        ends = np.cumsum(self.choices).tolist()
        return tuple(slice(end - n, end) for end, n in zip(ends, self.choices, strict=True))

    def rollout_type(self) -> np.dtype[np.void]:
        """Returns the element type of a rollout, an array ``(T, S)`` over steps and slots."""
        fields: list[tuple[Any, ...]] = [
            ("inputs", np.float32, (self.inputs,)),
            ("prior", np.float32, (sum(self.choices) * self.has_prior,)),
            ("state", np.float32, (self.state_size,)),
            ("choices", np.int64, (len(self.choices),)),
            ("log_probability", np.float32),
            ("values", np.float32),
            ("rewards", np.float32),
            ("next_values", np.float32),  # value after the last step of an ended race
            ("active", np.bool_),  # the kart raced, and the learner drove it
            ("driven", np.bool_),  # its choices applied
            ("ended", np.bool_),
        ]
        return np.dtype(fields, align=True)


def plan_shape(columns: Sequence[int]) -> PolicyShape:
    """Returns what a policy over plans sees and chooses."""
    return PolicyShape(INPUT_SIZE, PLAN_CHOICES, tuple(columns), has_prior=True)


def racing_shape(inputs: int = SIZE, num_mates: int = 0, memory_size: int = 0) -> PolicyShape:
    """Returns what a policy on the view ``racing`` or ``contest`` sees and chooses.

    Args:
        inputs: number of its inputs, without those of a recurrent policy's memory.
        num_mates: number of other learners whose own state the value network sees too.
        memory_size: size of the memory of a recurrent policy; 0 without one.
    """
    columns, state_size = tuple(range(len(CHOICES))), num_mates * _OWN.stop
    return PolicyShape(
        inputs + memory_size, CHOICES, columns, state_size=state_size, memory_size=memory_size
    )


def critic_inputs(rows: npt.NDArray[np.void]) -> FloatArray:
    """Returns the value network's inputs ``(N, inputs + state_size)`` in rows of a rollout."""
    return np.concatenate([rows["inputs"], rows["state"]], axis=-1)


def values_of(critic: Network, rows: npt.NDArray[np.void]) -> FloatArray:
    """Returns the values of rows of a rollout."""
    return critic(critic_inputs(rows))[:, 0]


def policy_logits(weights: Weights) -> Callable[[npt.NDArray[np.void]], FloatArray]:
    """Returns the function from rows of a rollout to a policy's logits, ``(N, sum(choices))``."""
    network = MlpDriver(weights).logits if is_network(weights) else Network(weights)

    def logits(rows: npt.NDArray[np.void]) -> FloatArray:
        learned: FloatArray = network(rows["inputs"])
        return learned + rows["prior"] if rows["prior"].shape[1] else learned

    return logits


def sample(
    logits: FloatArray, random: np.random.Generator, heads: Sequence[slice], columns: Sequence[int]
) -> tuple[IntArray, FloatArray]:
    """Samples choices from their logits ``(N, L)`` by Gumbel noise.

    Args:
        logits: logits of all choices.
        random: random generator.
        heads: slice of each choice's logits.
        columns: choices to sample; the others are the most likely ones and count as certain.

    Returns:
        Choices ``(N, C)`` and their log-probabilities ``(N,)``.
    """
    noise = random.gumbel(size=logits.shape).astype(np.float32)
    rows = np.arange(len(logits))
    drawn = np.empty((len(logits), len(heads)), np.intp)
    log_probability = np.zeros(len(logits), np.float32)
    for column, head in enumerate(heads):
        head_logits = logits[:, head]
        if column not in columns:
            drawn[:, column] = head_logits.argmax(axis=1)
            continue
        drawn[:, column] = choice = (head_logits + noise[:, head]).argmax(axis=1)
        log_probability += head_logits[rows, choice] - log_sum(head_logits)[:, 0]
    return drawn, log_probability


# ---------------------------------------------------------------------- results


@dataclass(frozen=True, slots=True)
class KartRace:
    """The race of a learner's kart.

    Attributes:
        company: its opponents: ``"alone"`` for none, ``"selfplay"`` or ``"rivals"``.
        reward: sum of its rewards.
        position: its position at the end; 1 is first.
        ratio: its time over the AI's median time; ``None`` if it did not finish.
    """

    company: str
    reward: float
    position: Place
    ratio: float | None


@dataclass(frozen=True, slots=True)
class RolloutResult:
    """Results of an actor's rollout that are not in its array.

    Attributes:
        last_values: ``(S,)`` values after its last step.
        finishes: the races of learners that ended.
        duels: name of the opponent and fraction of the duels that the learner won, for each race
            with an opponent that ended.
        kart_steps: number of steps that the learner and its opponents have driven.
    """

    last_values: FloatArray
    finishes: list[KartRace] = field(default_factory=list)
    duels: list[tuple[str, float]] = field(default_factory=list)
    kart_steps: int = 0


# ---------------------------------------------------------------------- actors


@dataclass(frozen=True, slots=True)
class ActorArguments:
    """Arguments of an actor.

    Attributes:
        groups: its races.
        shape: what the policy sees and chooses.
        plans: parameters of the plans among which the policy chooses; ``None`` without plans.
        past: folder of the past selves.
        bootstraps_finish: whether returns go on after the finish.
        hold: minimum steps of a drift without plans; ``None`` without an action filter.
    """

    groups: tuple[ActorRaces, ...]
    shape: PolicyShape
    plans: DriverParameters | None
    past: Path
    bootstraps_finish: bool
    hold: int | None = None

    @property
    def num_slots(self) -> int:
        """Number of slots of all its races."""
        return sum(group.num_races * group.num_agents for group in self.groups)


class RaceActor:
    """Drives some races with the learner's policy.

    Args:
        arguments: see :class:`ActorArguments`.
        memory: ``(2, T, S)`` of :meth:`PolicyShape.rollout_type`, two rollouts to fill in turn.
    """

    def __init__(self, arguments: ActorArguments, memory: SharedArray) -> None:
        self._rollouts = memory.array()
        self._parts: list[GroupActor] = []
        first = 0
        for group in arguments.groups:
            slots = slice(first, first + group.num_races * group.num_agents)
            self._parts.append(GroupActor(group, arguments, slots))
            first = slots.stop

    def begin(self, seed: Sequence[int]) -> None:
        """Starts new races."""
        for number, part in enumerate(self._parts):
            part.begin([*seed, number])

    def drive(self, number: int, policy: Weights, critic: Weights, odds: Odds) -> RolloutResult:
        """Fills a rollout.

        Args:
            number: number of the rollout, 0 or 1.
            policy: weights of the policy.
            critic: weights of the value network.
            odds: probability of each opponent in new races.
        """
        logits, values = policy_logits(policy), Network(critic)
        for part in self._parts:
            part.take_odds(odds)
            part.take_memory(policy)
        for step in self._rollouts[number]:
            for part in self._parts:
                part.send(step[part.slots], logits, values)
            for part in self._parts:
                part.receive(step[part.slots], values)
        results = [part.result(values) for part in self._parts]
        return RolloutResult(
            np.concatenate([part.last_values for part in results]),
            [finish for part in results for finish in part.finishes],
            [duel for part in results for duel in part.duels],
            sum(part.kart_steps for part in results),
        )

    def close(self) -> None:
        """Ends all races."""
        for part in self._parts:
            part.envs.close()


class GroupActor:
    """Drives the races of a group as one batch.

    Args:
        group: the races.
        arguments: arguments of the actor.
        slots: slots of the races among those of the actor.

    Attributes:
        envs: the races.
        slots: see the argument.
        seats: which karts the opponents drive.
    """

    def __init__(self, group: ActorRaces, arguments: ActorArguments, slots: slice) -> None:
        self.slots, self._group, self._arguments = slots, group, arguments
        if arguments.plans is None:
            races = RaceVectorEnv(group.num_races, **group.options)
            self.envs: Any = races
            if arguments.hold is not None:
                view = FilteredView(races.num_envs, arguments.hold, arguments.shape.memory_size)
                self.envs = MirroredRaces(races, view, MIRROR_SHARE)
        else:
            self.envs = PlanVectorEnv(
                group.num_races,
                parameters=arguments.plans,
                mirror_share=MIRROR_SHARE,
                **group.options,
            )
        self._inner: RaceVectorEnv = self.envs.unwrapped
        self.seats = RivalSeats(group.num_races, group.num_agents, group.teams)
        self._shares = _reward_shares(group)
        self._is_mate = self._shares > 0
        self._waits = np.zeros((group.num_races, group.num_agents), np.bool_)
        self._past: dict[str, Callable[[npt.NDArray[np.void]], FloatArray]] = {}

    def begin(self, seed: Sequence[int]) -> None:
        """Starts new races."""
        self._random = np.random.default_rng(seed)
        count = self._group.num_races
        seeds = self._random.integers(2**31, size=count).tolist()
        self._observations, _ = self.envs.reset(seed=seeds)
        self._chance = np.random.default_rng([*seed, 1])
        self._returns, self._kart_steps = np.zeros(self._inner.num_envs), 0
        self._waits[:] = False
        self._ai_times = [0.0] * count
        self._are_new, self._ended = True, RolloutResult(np.zeros(0, np.float32))

    def take_odds(self, odds: Odds) -> None:
        """Sets the probabilities of opponents in new races."""
        self._odds = odds if self._group.has_rivals else {}
        if self._are_new:
            for race in range(self._group.num_races):
                self._begin_race(race)
        self._are_new = False

    def take_memory(self, policy: Weights) -> None:
        """Sets how a recurrent policy computes its memory."""
        if size := self._arguments.shape.memory_size:
            inputs = self._arguments.shape.inputs - size
            self.envs.view.take_unit(GatedUnit(policy, inputs, "the policy"))

    def send(self, step: npt.NDArray[np.void], logits: Any, values: Network) -> None:
        """Chooses, starts a step of the races and fills a row of the rollout with what was seen."""
        self._see(step, self._observations)
        shape, own_logits = self._arguments.shape, logits(step)
        choices, log_probability = sample(own_logits, self._random, shape.heads, shape.columns)
        for name, rows in self.seats.rows_by_name().items():
            rival_logits = self._past_policy(name)(step[rows])
            choices[rows], _ = sample(rival_logits, self._chance, shape.heads, shape.columns)
        self._racing = self._inner.racing
        self.envs.step_async(choices)
        step["choices"], step["log_probability"] = choices, log_probability  # while the races run
        step["values"] = values_of(values, step)

    def receive(self, step: npt.NDArray[np.void], values: Network) -> None:
        """Waits for the step, and fills its row of the rollout with what followed."""
        self._observations, rewards, finished, cut, infos = self.envs.step_wait()
        is_own = self.seats.is_own.reshape(-1)
        by_race = rewards.reshape(self._group.num_races, -1)
        waits = self._waits.reshape(-1)
        step["active"] = (self._racing | waits) & is_own
        step["driven"] = self._racing & is_own & infos.get("applies", True)
        step["rewards"] = np.where(step["active"], (by_race @ self._shares).reshape(-1), 0.0)
        step["next_values"], step["values"][waits] = 0.0, 0.0
        step["ended"] = self._end_teams(finished, cut)
        self._returns += step["rewards"]
        self._kart_steps += int(self._racing.sum())
        goes_on = cut | (finished & self._arguments.bootstraps_finish)
        if goes_on.any():
            rows = np.flatnonzero(goes_on)
            last = step[rows].copy()  # if the race has been reset, with the state before the step
            self._see_last(last, infos["final_obs"][rows])
            step["next_values"][rows] = values_of(values, last)
        for slot in np.flatnonzero(finished | cut).tolist():
            self._end(slot, infos["final_info"], is_finished=bool(finished[slot]))

    def _end_teams(self, finished: BoolArray, cut: BoolArray) -> BoolArray:
        """Returns the slots that earn no reward after this step.

        A kart that has finished waits for its mates, whose rewards it shares.
        """
        ended = (finished | cut).reshape(self._waits.shape)
        drives_on = self._racing.reshape(ended.shape) & ~ended
        has_mate = (drives_on.astype(int) @ self._is_mate) > 0
        waited = self._waits | finished.reshape(ended.shape)
        self._waits = waited & has_mate
        return ((waited | ended) & ~self._waits).reshape(-1)

    def result(self, values: Network) -> RolloutResult:
        """Returns the other results of the rollout."""
        latest = np.zeros(self._inner.num_envs, self._arguments.shape.rollout_type())
        self._see(latest, self._observations)
        ended, self._ended = self._ended, RolloutResult(np.zeros(0, np.float32))
        kart_steps, self._kart_steps = self._kart_steps, 0
        last_values = np.where(self._waits.reshape(-1), 0, values_of(values, latest))
        return replace(ended, last_values=last_values, kart_steps=kart_steps)

    def _see(self, rows: npt.NDArray[np.void], observations: Any) -> None:
        """Writes observations of all slots into rows of a rollout."""
        if isinstance(observations, Mapping):
            rows["inputs"], rows["prior"] = observations["inputs"], observations["prior"]
        else:
            rows["inputs"] = observations
        if self._arguments.shape.state_size:
            rows["state"] = self._others(rows["inputs"])

    def _others(self, inputs: FloatArray) -> FloatArray:
        """Returns the own state of the other learners of each race: mates first, then by rank."""
        count = self._group.num_agents
        by_race = inputs.reshape(-1, count, inputs.shape[1])
        order = by_race[:, None, :, _RANK] + 10.0 * ~self._is_mate + 100.0 * np.eye(count)
        others = order.argsort(axis=2)[:, :, :-1]  # the last one is the kart itself
        return by_race[np.arange(len(by_race))[:, None, None], others, _OWN].reshape(
            len(inputs), -1
        )

    def _see_last(self, rows: npt.NDArray[np.void], observations: Sequence[Any]) -> None:
        """Writes the last observations of some slots into rows of a rollout."""
        for row, seen in zip(rows, observations, strict=True):
            row["inputs"] = seen["inputs"] if isinstance(seen, Mapping) else seen

    def _begin_race(self, race: int) -> None:
        """Draws the drivers of a race that begins."""
        self.seats.seat(race, draw_opponent(self._odds, self._chance), self._chance)
        self._returns.reshape(self._waits.shape)[race] = 0.0
        facts = self._inner.races[race].race
        assert facts is not None  # noqa: S101 - after a reset
        self._ai_times[race] = ai_time(facts.track, facts.reverse, facts.difficulty)

    def _end(self, slot: int, last: Mapping[str, Any], *, is_finished: bool) -> None:
        """Records the end of a kart's race, and of the race if it was the last kart."""
        race, agent = divmod(slot, self._group.num_agents)
        position = int(last["position"][slot])
        if self.seats.is_own[race, agent]:
            time = float(last["finish_time"][slot])
            ratio = time / self._ai_times[race] if is_finished else None
            reward = float(self._returns[slot])
            self._ended.finishes.append(KartRace(self._group.company, reward, position, ratio))
        if self.seats.end(slot, position):
            beaten = self.seats.beaten(race)
            if beaten is not None:
                self._ended.duels.append((self.seats.names[race], beaten))
            self._begin_race(race)

    def _past_policy(self, name: str) -> Callable[[npt.NDArray[np.void]], FloatArray]:
        if name not in self._past:
            file = self._arguments.past / f"{name}.safetensors"
            self._past[name] = policy_logits(load_weights(file))
        return self._past[name]


def _reward_shares(group: ActorRaces) -> npt.NDArray[np.float64]:
    """Returns the share of each agent's reward that each agent gets, ``(A, A)``.

    As :class:`~stkzoo.wrappers.marl.Teams` does with ``share=1``, every member gets the mean over
    its team; members that have left count as 0.
    """
    shares = np.eye(group.num_agents)
    for team in group.teams:
        shares[np.ix_(team, team)] = 1 / len(team)
    return shares
