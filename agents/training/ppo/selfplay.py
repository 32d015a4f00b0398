"""Learns to race by playing against itself: PPO in one file, on many karts at once.

    python -m stkzoo.agents.training.ppo.selfplay --output runs/first --until 2000000

Proximal policy optimisation (Schulman et al., 2017) with one policy on all karts of many races,
among themselves and against the game's AI. A small network sees the racing view
(:mod:`stkzoo.wrappers.racing`), what the driver remembers and what plans for the next two seconds
are worth (:mod:`stkzoo.agents.pretrained`), and chooses what to begin, nitro and fire, and if told
how much to turn beside the plan. It begins as the best plan's driver, and learns what to add. Half
of the karts, drawn anew in each race, drive in the mirror: left is right. The reward is the way
along the track and places won; a finish is no end of earning, so that nobody slows down for it.

``--until`` is how many kart-steps there shall have been in all: the same command with a higher
number goes on, and so does the same command after the program was killed, exactly as if
it had not been. In the folder are ``checkpoint.pt``, ``log.jsonl`` (a line an iteration),
TensorBoard's files, ``arguments.json``, and ``policy-STEPS.safetensors`` now and then, which
``python -m stkzoo.agents.training.export`` makes an agent of.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._os import atomic_write
from stkzoo.agents.planning import (
    CHOICE_NAMES,
    CHOICES,
    HEADS,
    INPUT_SIZE,
    PolicyInput,
    mirrored_inputs,
)
from stkzoo.agents.pretrained.policy import INPUT_CLIP, RacingPolicy, network
from stkzoo.agents.pretrained.weights import load_weights, save_weights
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.tracks import TRAIN_TRACKS

from ..common.arguments import ARGUMENTS, add_arguments, changes, training_torch, values_of
from ..common.fleet import Finish, Fleet, RaceForm, StepOutcome
from ..common.plan_parameters import plan_numbers
from ..common.training_log import Journal

__all__ = ["Arguments", "Learner", "main"]

FloatArray = npt.NDArray[np.float32]

_CHECKPOINT = "checkpoint.pt"
_NUM_LOGITS = sum(CHOICES)
#: Finished races over which the log's figures are means.
_RECENT = 200
#: A kart that did not finish counts as having taken so many times the AI's time.
_UNFINISHED = 3.0


@dataclass(frozen=True, slots=True)
class Arguments:
    """What a run is made of; kept in its checkpoint, and a run goes on with the same only.

    Attributes:
        seed: of everything.
        total: kart-steps over which learning rate and entropy bonus go down.
        tracks: train on these.
        forms: races side by side, ``"8x5"`` is five of eight learners, ``"4+2x3"`` three of
            four learners and two of the game's AI at its hardest.
        plans: the numbers that plans go by: found by a search, or by-hand.
        groups: the races are dealt out to so many groups; one thinks while the others drive.
        steps: steps of every race between two updates.
        epochs: how often an update goes over what was seen.
        minibatch: karts-steps of a gradient.
        learning_rate: at the start.
        entropy: bonus at the start.
        leash: cost of a nat of divergence from the prior.
        learns: which choices are learned; the others stay those of the plans alone, or of ``init``.
        place_reward: what a place is worth; a metre of way is worth 0.05.
        gamma: discount of a step.
        trace: lambda of the advantage.
        clip: how far a probability may move in one update, as a share.
        target_kl: an update ends early beyond this.
        warm_up: iterations at the start in which only the value is learned.
        hidden: units of the layers.
        init: start from these weights of a policy; empty starts from nothing.
        keep_every: kart-steps between two kept policies.
        checkpoint_every: iterations between two checkpoints.
    """

    seed: int = 0
    total: int = 20_000_000
    tracks: tuple[str, ...] = tuple(track for track in TRAIN_TRACKS if track != "black_forest")
    forms: tuple[str, ...] = ("1x8", "5x8", "2+3x8", "1+4x8")
    plans: str = "found"
    groups: int = 2
    steps: int = 128
    epochs: int = 3
    minibatch: int = 4096
    learning_rate: float = 3e-4
    entropy: float = 0.0
    leash: float = 5e-3
    learns: tuple[str, ...] = ("begin", "nitro", "fire")
    place_reward: float = 0.1
    gamma: float = 0.98
    trace: float = 0.85
    clip: float = 0.2
    target_kl: float = 0.02
    warm_up: int = 10
    hidden: tuple[int, ...] = (256, 128)
    init: str = ""
    keep_every: int = 500_000
    checkpoint_every: int = 20


def race_forms(texts: Sequence[str]) -> list[RaceForm]:
    """The forms that ``Arguments.forms`` means, one a race."""
    forms = []
    for text in texts:
        try:
            who, _, count = text.partition("x")
            learners, _, rivals = who.partition("+")
            forms += [RaceForm(int(learners), int(rivals or 0))] * int(count or 1)
        except ValueError:  # noqa: PERF203 - it is rare
            raise ConfigError(
                f"race form {text!r} is unknown; expected such as 8x5 or 4+2x3"
            ) from None
    return forms


class _Network:
    """Policy and value with their optimiser."""

    def __init__(self, arguments: Arguments) -> None:
        self.torch = torch = training_torch()
        torch.manual_seed(arguments.seed)
        size = INPUT_SIZE
        self.mean, self.scale = np.zeros(size, np.float32), np.ones(size, np.float32)
        self.policy = self._layers((size, *arguments.hidden, _NUM_LOGITS), 0.01)
        self.columns = _columns(arguments.learns)
        with torch.no_grad():
            for column in set(range(len(HEADS))) - set(self.columns):
                self.policy[-1].weight[HEADS[column]] = 0.0
        self.value = self._layers((size, *arguments.hidden, 1), 1.0)
        if arguments.init:
            self._start_from(load_weights(arguments.init))
        self.optimiser = torch.optim.Adam(
            [{"params": self.policy.parameters()}, {"params": self.value.parameters()}], eps=1e-5
        )

    def _layers(self, sizes: Sequence[int], last_gain: float) -> Any:
        nn = self.torch.nn
        parts: list[Any] = []
        for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
            is_last = number == len(sizes) - 2
            layer = nn.Linear(inputs, outputs)
            nn.init.orthogonal_(layer.weight, last_gain if is_last else 2**0.5)
            nn.init.zeros_(layer.bias)
            parts += [layer] if is_last else [layer, nn.ReLU()]
        return nn.Sequential(*parts)

    def _start_from(self, weights: dict[str, FloatArray]) -> None:
        self.mean, self.scale = weights["mean"], weights["scale"]
        with self.torch.no_grad():
            for number, layer in enumerate(self.policy[::2]):
                layer.weight.copy_(self.torch.from_numpy(weights[f"w{number}"].T.copy()))
                layer.bias.copy_(self.torch.from_numpy(weights[f"b{number}"]))

    def _arrays(self, layers: Any) -> dict[str, FloatArray]:
        arrays = {"mean": self.mean, "scale": self.scale}
        for number, layer in enumerate(layers[::2]):
            arrays[f"w{number}"] = layer.weight.detach().numpy().T.copy()
            arrays[f"b{number}"] = layer.bias.detach().numpy().copy()
        return arrays

    def actor(self) -> RacingPolicy:
        """The policy as it is now, in numpy."""
        return RacingPolicy(self._arrays(self.policy))

    def critic(self) -> dict[str, FloatArray]:
        """The weights of the value as they are now."""
        return self._arrays(self.value)

    def normalise_by(self, inputs: FloatArray) -> None:
        """Takes mean and scale from inputs, the same for a race and its mirror image."""
        both = np.concatenate([inputs, mirrored_inputs(inputs)])
        self.mean = both.mean(axis=0)
        self.scale = 1.0 / np.maximum(both.std(axis=0), _LEAST_SCALE)

    def normalised(self, inputs: FloatArray) -> Any:
        """A tensor of what the layers are given."""
        return self.torch.from_numpy(
            np.clip((inputs - self.mean) * self.scale, -INPUT_CLIP, INPUT_CLIP)
        )

    def state(self) -> dict[str, Any]:
        return {
            "policy": self.policy.state_dict(),
            "value": self.value.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "mean": self.torch.from_numpy(self.mean),
            "scale": self.torch.from_numpy(self.scale),
        }

    def restore(self, state: dict[str, Any]) -> None:
        self.policy.load_state_dict(state["policy"])
        self.value.load_state_dict(state["value"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.mean, self.scale = state["mean"].numpy(), state["scale"].numpy()


@dataclass(slots=True)
class _Rollout:
    """What a group saw and did in an iteration; ``(T, S, ...)`` arrays."""

    inputs: FloatArray
    prior: FloatArray
    choices: npt.NDArray[np.int64]
    log_probability: FloatArray
    values: FloatArray
    rewards: FloatArray
    active: npt.NDArray[np.bool_]
    driven: npt.NDArray[np.bool_]
    ended: npt.NDArray[np.bool_]
    next_values: FloatArray  # of what was seen last, where a race ended
    finishes: list[Finish] = field(default_factory=list)

    @classmethod
    def of_size(cls, steps: int, slots: int) -> _Rollout:
        shape = steps, slots
        numbers = [np.zeros(shape, np.float32) for _ in range(4)]
        return cls(
            np.zeros((*shape, INPUT_SIZE), np.float32),
            np.zeros((*shape, _NUM_LOGITS), np.float32),
            np.zeros((*shape, len(CHOICES)), np.int64),
            numbers[0],
            numbers[1],
            numbers[2],
            np.zeros(shape, bool),
            np.zeros(shape, bool),
            np.zeros(shape, bool),
            numbers[3],
        )

    def advantages(self, last_values: FloatArray, gamma: float, trace: float) -> FloatArray:
        """Generalised advantages ``(T, S)``; an ended race goes on with its last value."""
        advantages = np.zeros_like(self.rewards)
        later, after = np.zeros_like(last_values), last_values
        for step in reversed(range(len(self.rewards))):
            ended = self.ended[step]
            after = np.where(ended, self.next_values[step], after)
            delta = self.rewards[step] + gamma * after - self.values[step]
            later = delta + gamma * trace * np.where(ended, 0, later)
            later = np.where(self.active[step], later, 0).astype(np.float32)
            advantages[step], after = later, self.values[step]
        return advantages


class Learner:
    """A run: its races, networks and files.

    Args:
        folder: where it is kept.
        arguments: what it is made of.
        may_change: go on with these arguments where the run had others, from here on.

    Raises:
        ConfigError: the folder holds a run of other arguments, or something cannot be.
    """

    def __init__(
        self, folder: str | Path, arguments: Arguments, *, may_change: bool = False
    ) -> None:
        self.folder, self.arguments = Path(folder), arguments
        self.folder.mkdir(parents=True, exist_ok=True)
        self._network = _Network(arguments)
        self._random = np.random.default_rng([arguments.seed, 1])
        self._rules = plan_numbers(arguments.plans)
        forms = race_forms(arguments.forms)
        self._fleets: list[Fleet] = []
        for group in range(arguments.groups):
            own = forms[group :: arguments.groups]
            shared = self._fleets[0].parked if self._fleets else None
            seed = int(np.random.SeedSequence([arguments.seed, group]).generate_state(1)[0])
            fleet = Fleet(
                own,
                arguments.tracks,
                seed,
                place_reward=arguments.place_reward,
                parked=shared,
                rules=self._rules,
            )
            self._fleets.append(fleet)
        self._rollouts = [
            _Rollout.of_size(arguments.steps, fleet.num_slots) for fleet in self._fleets
        ]
        self.kart_steps = self.iteration = 0
        self._history: list[dict[str, Any]] = [self._chapter(0)]
        self._recent: deque[Finish] = deque(maxlen=_RECENT)
        if (self.folder / _CHECKPOINT).exists():
            self._views = self._restore(may_change)
        else:
            self._views = [fleet.begin() for fleet in self._fleets]
        with atomic_write(self.folder / ARGUMENTS) as part:
            part.write_text(json.dumps(self._history, indent=1) + "\n")

    def iterate(self) -> dict[str, float]:
        """One iteration: drives, learns, and returns its line of the log."""
        begin = time.perf_counter()
        lasts = self._drive()
        if self.iteration == 0 and not self.arguments.init:
            seen = [rollout.inputs[rollout.active] for rollout in self._rollouts]
            self._network.normalise_by(np.concatenate(seen))
        driven = time.perf_counter()
        learned = self._learn(lasts)
        self.iteration += 1
        steps = int(sum(rollout.active.sum() for rollout in self._rollouts))
        self.kart_steps += steps
        for rollout in self._rollouts:
            self._recent.extend(rollout.finishes)
        end = time.perf_counter()
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            **self._racing_figures(),
            **learned,
            "drive_s": driven - begin,
            "learn_s": end - driven,
            "kart_steps_per_s": steps / (end - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def close(self) -> None:
        """Ends all races."""
        for fleet in self._fleets:
            fleet.close()

    # ------------------------------------------------------------------ driving

    def _drive(self) -> list[FloatArray]:
        """Fills the rollouts; the values of what was seen last."""
        actor, critic = self._network.actor(), self._network.critic()
        for rollout in self._rollouts:
            rollout.finishes.clear()
        for group in range(len(self._fleets)):
            self._act(group, 0, actor, critic)
        for step in range(self.arguments.steps):
            for group, fleet in enumerate(self._fleets):
                self._views[group], outcome = fleet.receive()
                outcome = self._judged(group, outcome)
                rollout = self._rollouts[group]
                rollout.rewards[step], rollout.active[step] = outcome.rewards, outcome.active
                rollout.ended[step] = outcome.ended
                rollout.finishes += outcome.finishes
                if outcome.ended.any():
                    last = _values(critic, outcome.last_inputs[outcome.ended])
                    rollout.next_values[step, outcome.ended] = last
                if step + 1 < self.arguments.steps:
                    self._act(group, step + 1, actor, critic)
        return [_values(critic, view.inputs) for view in self._views]

    def _act(
        self, group: int, step: int, actor: RacingPolicy, critic: dict[str, FloatArray]
    ) -> None:
        view, rollout = self._views[group], self._rollouts[group]
        choices, log_probability = self._choose(group, view, actor)
        rollout.driven[step] = self._fleets[group].send(choices)
        rollout.inputs[step], rollout.prior[step] = view.inputs, view.prior
        rollout.choices[step], rollout.log_probability[step] = choices, log_probability
        rollout.values[step] = _values(critic, view.inputs)

    def _choose(
        self,
        group: int,  # noqa: ARG002 - a league lets others drive some karts of a group
        view: PolicyInput,
        actor: RacingPolicy,
    ) -> tuple[npt.NDArray[np.intp], FloatArray]:
        """What the karts of a group do, and the logarithms of its probabilities."""
        return actor.sample(view, self._random, self._network.columns)

    def _judged(
        self,
        group: int,  # noqa: ARG002 - a league takes out what others did in a group
        outcome: StepOutcome,
    ) -> StepOutcome:
        """What counts of a step."""
        return outcome

    # ------------------------------------------------------------------ learning

    def _learn(self, lasts: Sequence[FloatArray]) -> dict[str, float]:
        arguments, nets = self.arguments, self._network
        parts = []
        for rollout, last in zip(self._rollouts, lasts, strict=True):
            gains = rollout.advantages(last, arguments.gamma, arguments.trace)
            rows = rollout.active & rollout.driven
            parts.append(
                (
                    rollout.inputs[rows],
                    rollout.prior[rows],
                    rollout.choices[rows],
                    rollout.log_probability[rows],
                    gains[rows],
                    (gains + rollout.values)[rows],
                )
            )
        inputs, prior, choices, before, gains, targets = (
            np.concatenate(column) for column in zip(*parts, strict=True)
        )
        share = max(1.0 - self.kart_steps / arguments.total, 0.0)
        rate = arguments.learning_rate * max(share, 0.05)
        is_warming = self.iteration < arguments.warm_up
        nets.optimiser.param_groups[0]["lr"] = 0.0 if is_warming else rate
        nets.optimiser.param_groups[1]["lr"] = _VALUE_RATE * rate
        from_numpy = nets.torch.from_numpy
        data = (
            nets.normalised(inputs),
            from_numpy(prior),
            from_numpy(choices),
            from_numpy(before),
            from_numpy((gains - gains.mean()) / (gains.std() + 1e-6)),
            from_numpy(targets / _VALUE_UNIT),
        )
        sums: dict[str, list[float]] = {}
        entropy = arguments.entropy * max(share, 0.1)
        epochs = 0
        for _ in range(arguments.epochs):
            epochs += 1
            kl = []
            for rows in self._minibatches(len(inputs)):
                found = self._gradient([column[rows] for column in data], entropy)
                kl.append(found["kl"])
                for name, value in found.items():
                    sums.setdefault(name, []).append(value)
            if np.mean(kl) > arguments.target_kl:
                break
        unexplained = np.var(targets - (targets - gains)) / max(float(np.var(targets)), 1e-9)
        return {
            **{name: float(np.mean(values)) for name, values in sums.items()},
            "epochs": epochs,
            "learning_rate": rate,
            "explained": float(1.0 - unexplained),
            "reward": float(sum(r.rewards.sum() for r in self._rollouts) / len(inputs)),
        }

    def _minibatches(self, count: int) -> list[Any]:
        order = self._network.torch.from_numpy(self._random.permutation(count))
        return [part for part in order.split(self.arguments.minibatch) if len(part) > 1]

    def _gradient(self, data: Sequence[Any], bonus: float) -> dict[str, float]:
        """One step of the optimiser."""
        inputs, prior, choices, before, gains, targets = data
        torch, nets = self._network.torch, self._network
        logits = prior + nets.policy(inputs)
        now, entropy, strayed = _chosen(torch, logits, prior, choices, nets.columns)
        change = now - before
        ratio = change.exp()
        clip = self.arguments.clip
        won = torch.minimum(ratio * gains, ratio.clamp(1 - clip, 1 + clip) * gains).mean()
        value_loss = (nets.value(inputs)[:, 0] - targets).square().mean()
        loss = value_loss - won - bonus * entropy.mean() + self.arguments.leash * strayed.mean()
        nets.optimiser.zero_grad()
        loss.backward()
        for layers in (nets.policy, nets.value):
            torch.nn.utils.clip_grad_norm_(layers.parameters(), 0.5)
        nets.optimiser.step()
        with torch.no_grad():
            return {
                "kl": float((ratio - 1 - change).mean()),
                "clipped": float(((ratio - 1).abs() > clip).float().mean()),
                "entropy": float(entropy.mean()),
                "strayed": float(strayed.mean()),
                "value_loss": float(value_loss),
            }

    # ------------------------------------------------------------------ keeping

    def _racing_figures(self) -> dict[str, float]:
        figures = {}
        for name in ("alone", "selfplay", "rivals"):
            own = [end for end in self._recent if _company(end.form) == name]
            if not own:
                continue
            finished = [end.ratio for end in own if end.ratio is not None]
            figures[f"{name}_ratio"] = float(
                np.mean([_UNFINISHED if end.ratio is None else end.ratio for end in own])
            )
            figures[f"{name}_finished_ratio"] = float(np.mean(finished)) if finished else 0.0
            figures[f"{name}_unfinished"] = 1.0 - len(finished) / len(own)
            if name == "rivals":
                figures["rivals_rank"] = float(np.mean([end.rank for end in own]))
                figures["rivals_first"] = float(np.mean([end.rank == 1 for end in own]))
        return figures

    def save_checkpoint(self) -> None:
        """Writes ``checkpoint.pt``, from which the run goes on exactly."""
        facts = {
            "history": self._history,
            "kart_steps": self.kart_steps,
            "iteration": self.iteration,
            "random": self._random.bit_generator.state,
            "recent": [asdict(finish) for finish in self._recent],
        }
        torch = self._network.torch
        state = {
            "facts": json.dumps(facts),
            "network": self._network.state(),
            "fleets": [_tensors(torch, fleet.state()) for fleet in self._fleets],
        }
        with atomic_write(self.folder / _CHECKPOINT) as part:
            torch.save(state, part)

    def save_policy(self) -> Path:
        """Writes the policy as it is now; its path."""
        path = self.folder / f"policy-{self.kart_steps:09d}.safetensors"
        save_weights(path, self._network.actor().weights)
        return path

    def _chapter(self, kart_steps: int) -> dict[str, Any]:
        """What holds from a number of kart-steps on."""
        rules = asdict(self._rules)
        return {"from": kart_steps, "arguments": asdict(self.arguments), "rules": rules}

    def _restore(self, may_change: bool) -> list[PolicyInput]:
        torch = self._network.torch
        state = torch.load(self.folder / _CHECKPOINT, weights_only=True)
        facts = json.loads(state["facts"])
        now = self._chapter(facts["kart_steps"])
        self._history = facts["history"]
        last = self._history[-1]
        told = [changes(last.get(part, {}), now[part]) for part in ("arguments", "rules")]
        if any(told) and not may_change:
            raise ConfigError(
                f"the run in {str(self.folder)!r} has other arguments or numbers of plans: "
                f"{', '.join(filter(None, told))}; give the same, another --output, or "
                "--may-change to go on with these"
            )
        if any(told):
            self._history.append(now)
        self.kart_steps, self.iteration = facts["kart_steps"], facts["iteration"]
        self._random.bit_generator.state = facts["random"]
        for finish in facts["recent"]:
            self._recent.append(Finish(**{**finish, "form": RaceForm(**finish["form"])}))
        self._network.restore(state["network"])
        return [
            fleet.restore(_arrays(kept))
            for fleet, kept in zip(self._fleets, state["fleets"], strict=True)
        ]


def _company(form: RaceForm) -> str:
    """Whom a learner of a race drives among."""
    return "rivals" if form.rivals else "selfplay" if form.learners > 1 else "alone"


#: Inputs that hardly change are not blown up.
_LEAST_SCALE = np.float32(0.2)

#: The value learns faster than the policy.
_VALUE_RATE = 4.0

#: What the value network's output of 1 means.
_VALUE_UNIT = 10.0


def _values(critic: dict[str, FloatArray], inputs: FloatArray) -> FloatArray:
    values: FloatArray = network(critic, inputs)[:, 0] * np.float32(_VALUE_UNIT)
    return values


def _columns(names: Sequence[str]) -> list[int]:
    """Where choices of these names stand."""
    unknown = sorted(set(names) - set(CHOICE_NAMES))
    if unknown or not names:
        raise ConfigError(f"learns is {list(names)}; expected some of {', '.join(CHOICE_NAMES)}")
    return sorted(CHOICE_NAMES.index(name) for name in set(names))


def _chosen(
    torch: Any, logits: Any, prior: Any, choices: Any, columns: Sequence[int]
) -> tuple[Any, Any, Any]:
    """The choices' log-probability, the entropy, the divergence from the prior; ``(B,)`` each."""
    now, entropy, strayed = 0.0, 0.0, 0.0
    for column in columns:
        head = HEADS[column]
        logs = torch.log_softmax(logits[:, head], dim=1)
        logs_before = torch.log_softmax(prior[:, head], dim=1)
        now = now + logs.gather(1, choices[:, column : column + 1])[:, 0]
        entropy = entropy - (logs.exp() * logs).sum(1)
        strayed = strayed + (logs.exp() * (logs - logs_before)).sum(1)
    return now, entropy, strayed


def _tensors(torch: Any, value: Any) -> Any:
    """Arrays as tensors, and what a file of tensors cannot hold as JSON."""
    if isinstance(value, np.ndarray):
        return torch.from_numpy(value)
    if isinstance(value, dict):
        if "bit_generator" in value:
            return "json:" + json.dumps(value)
        return {key: _tensors(torch, part) for key, part in value.items()}
    if isinstance(value, list):
        return [_tensors(torch, part) for part in value]
    return value


def _arrays(value: Any) -> Any:
    """The reverse of :func:`_tensors`."""
    if hasattr(value, "numpy"):
        return value.numpy()
    if isinstance(value, str) and value.startswith("json:"):
        return json.loads(value.removeprefix("json:"))
    if isinstance(value, dict):
        return {key: _arrays(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_arrays(part) for part in value]
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.ppo.selfplay",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", required=True, help="the run's folder")
    parser.add_argument("--until", type=int, required=True, help="kart-steps in all")
    parser.add_argument(
        "--may-change",
        action="store_true",
        help="go on with other arguments than the run had; it is noted in arguments.json",
    )
    add_arguments(parser, Arguments)
    return parser


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = vars(_parser().parse_args(words))
    folder, until = options.pop("output"), options.pop("until")
    may_change = options.pop("may_change")
    arguments = Arguments(**values_of(options))
    try:
        learner = Learner(folder, arguments, may_change=may_change)
    except StkzooError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    journal = Journal(learner.folder, learner.iteration)
    try:
        _run(learner, journal, until)
    finally:
        journal.close()
        learner.close()
    return 0


def _run(learner: Learner, journal: Journal, until: int) -> None:
    arguments = learner.arguments
    while learner.kart_steps < until:
        before = learner.kart_steps
        line = learner.iterate()
        journal.write(line)
        _tell(line)
        if learner.kart_steps // arguments.keep_every > before // arguments.keep_every:
            learner.save_policy()
        if learner.iteration % arguments.checkpoint_every == 0:
            learner.save_checkpoint()
    learner.save_checkpoint()
    learner.save_policy()


_TOLD = (
    "alone_ratio",
    "selfplay_ratio",
    "rivals_ratio",
    "rivals_rank",
    "entropy",
    "kl",
    "explained",
)


def _tell(line: dict[str, float]) -> None:
    figures = [f"{name} {line[name]:.3f}" for name in _TOLD if name in line]
    speed = line["kart_steps_per_s"]
    print(f"{line['kart_steps']:>10,.0f}  {'  '.join(figures)}  {speed:.0f}/s", flush=True)


if __name__ == "__main__":
    sys.exit(main())
