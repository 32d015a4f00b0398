"""Trains a policy over plans by self-play with PPO, in many parallel races.

    python -m stkzoo.agents.training.ppo.selfplay --output runs/first --total-timesteps 2000000

One policy drives all karts of many races, against itself and against the game's AI, and is trained
with proximal policy optimization (Schulman et al., 2017). A small network sees the racing view
(:mod:`stkzoo.wrappers.racing`), the driver's memory, and the worth of plans for the next two
seconds (:mod:`stkzoo.agents.planning`). It chooses which manoeuvre to begin, nitro and fire, and
optionally a steering offset from the plan. Training starts from the driver that takes the best
plan. Half of the karts, drawn for each race, drive mirrored left to right. The reward is the
distance driven along the track plus places gained. The return does not end at the finish, so that
karts do not slow down before it.

To continue a run, also after a kill, run the same command again, perhaps with more
``--total-timesteps``. The run continues bit for bit, because all races restart after a checkpoint.
The folder contains ``checkpoint.pt``, ``log.jsonl`` (one line per iteration), TensorBoard files,
``arguments.json``, and ``policy-STEPS.safetensors``, which ``python -m
stkzoo.agents.training.export`` converts to an agent.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
import numpy.typing as npt

from stkzoo._arguments import option
from stkzoo._os import cpu_count
from stkzoo._schema import Count, Within
from stkzoo.agents.planning.arrays import FloatArray
from stkzoo.agents.planning.parameters import DriverParameters
from stkzoo.agents.pretrained.weights import save_weights
from stkzoo.errors import ConfigError, check_whole

from ..common.actors import ActorPool, SharedArray
from ..common.arguments import QUICK_TRACKS, PPOArguments, ScriptOptions
from ..common.command import ProgressBar, run_command
from ..common.fleet import Finish, Lineup, parse_races
from ..common.run_folder import (
    ARGUMENTS,
    TrainingLog,
    check_resumed,
    load_checkpoint,
    plan_parameters,
    reading_checkpoint,
    save_checkpoint,
    write_json,
)
from .network import ActorCritic
from .rollouts import ROLLOUT, VALUE_UNIT, ActorArguments, Driven, RaceActor, advantages_of

#: Number of finished races in the means of the log.
_RECENT = 200
#: Ratio of the learning rates of value and policy.
_VALUE_RATE = 4.0


# ---------------------------------------------------------------------- arguments


@dataclass(frozen=True, slots=True)
class SelfPlayArguments(PPOArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        tracks: tracks or splits to train on, such as train_only.
        races: parallel races: 8x5 is five races of eight learners, 4+2x3 three races of four
            learners and two karts of the game's AI at its highest difficulty.
        plans: JSON file of plan parameters, such as best.json of tune_plans; empty is the default.
        turn_hold: steps for which a steering offset holds; with 1, the policy chooses it in every
            step. None is as in plans.
        actors: number of processes that drive the races; 0 is one for each processor core.
            Results depend on their number.
        on_policy: drive each rollout with the latest networks. By default, the actors drive the
            next rollout during an update, with the networks before it.
        n_steps: steps of each race between two updates.
        anneal_timesteps: kart-steps over which learning rate and entropy coefficient decay.
        kl_coef: coefficient of the KL penalty towards the plans' prior.
        learns: choices to train; the others stay those of the plans, or of --init.
        place_reward: reward per place; the reward per metre is 0.05.
        target_kl: KL divergence at which an update stops early.
        warm_up: iterations at the start that train only the value network.
        init: policy file to start from; empty starts from the plans.
        keep_every: kart-steps between two saved policies.
        checkpoint_every: iterations between two checkpoints.
    """

    may_be_zero: ClassVar[tuple[str, ...]] = ("seed", "warm_up", "actors")

    batch_size: int = 4096
    n_epochs: int = 3
    gae_lambda: float = 0.85
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")
    races: tuple[str, ...] = ("1x8", "5x8", "2+3x8", "1+4x8")
    plans: str = ""
    turn_hold: int | None = None
    actors: int = 0
    on_policy: bool = False
    n_steps: int = 128
    anneal_timesteps: int = 20_000_000
    kl_coef: float = 5e-3
    learns: tuple[str, ...] = ("begin", "nitro", "fire")
    place_reward: float = 0.1
    target_kl: float = 0.02
    warm_up: int = 10
    init: str = ""
    keep_every: int = 500_000
    checkpoint_every: int = 20


# ---------------------------------------------------------------------- the algorithm


@dataclass(frozen=True, slots=True)
class LearnerFacts:
    """The facts in a checkpoint.

    Attributes:
        history: the arguments, each with the kart-steps from which on they hold.
        kart_steps: driven by then.
        iteration: number of iterations by then.
        recent: the latest finishes.
    """

    history: Annotated[list[dict[str, Any]], Within(1)]
    kart_steps: Count
    iteration: Count
    recent: tuple[Finish, ...]

    def __post_init__(self) -> None:
        for chapter in self.history:
            parts = chapter.get("arguments"), chapter.get("rules", {})
            if not all(isinstance(part, dict) for part in parts):
                raise ConfigError("history has no arguments or rules")


class PPOLearner:
    """A run: its races, networks and files.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.
        may_change: whether to continue even if the run had other arguments.

    Raises:
        ConfigError: the folder contains a run with other arguments, or an argument is invalid.
    """

    def __init__(
        self, folder: str | Path, arguments: SelfPlayArguments, *, may_change: bool = False
    ) -> None:
        self.folder, self.arguments = Path(folder), arguments
        self.folder.mkdir(parents=True, exist_ok=True)
        self._network = ActorCritic(
            arguments.hidden, arguments.seed, arguments.learns, arguments.init
        )
        self._rules = _plan_rules(arguments)
        lineups = parse_races(arguments.races)
        self.kart_steps = self.iteration = 0
        self._history: list[dict[str, Any]] = [self._chapter()]
        self._recent: deque[Finish] = deque(maxlen=_RECENT)
        if checkpoint := load_checkpoint(self.folder, LearnerFacts):
            self._restore(*checkpoint, may_change)
        write_json(self.folder / ARGUMENTS, self._history)
        self._start_actors(lineups)
        self.begin_races()

    def _start_actors(self, lineups: Sequence[Lineup]) -> None:
        arguments = self.arguments
        count = min(arguments.actors or cpu_count(), len(lineups))
        shares = [
            ActorArguments(
                lineups=tuple(lineups[number::count]),
                tracks=arguments.tracks,
                place_reward=arguments.place_reward,
                rules=self._rules,
                learns=arguments.learns,
            )
            for number in range(count)
        ]
        memories = [
            SharedArray((2, arguments.n_steps, share.num_slots), ROLLOUT) for share in shares
        ]
        self._rollouts = [memory.array() for memory in memories]
        self._actors = self._new_actors(list(zip(shares, memories, strict=True)))

    def _new_actors(self, arguments: Sequence[tuple[ActorArguments, SharedArray]]) -> ActorPool:
        return ActorPool(RaceActor, arguments)

    def begin_races(self) -> None:
        """Starts new races; later random numbers derive from seed and iteration."""
        seed = self.arguments.seed
        self._random = np.random.default_rng([seed, self.iteration])
        self._actors.forget()
        seeds = [([seed, self.iteration, number],) for number in range(len(self._actors))]
        self._actors.call("begin", seeds)

    def iterate(self) -> dict[str, float]:
        """Updates the networks with a rollout; returns the log entry."""
        begin = time.perf_counter()
        if not self._actors.is_busy:
            self._drive(self.iteration)
        driven = self._driven()
        rollouts = [memory[self.iteration % 2] for memory in self._rollouts]
        if self.iteration == 0 and not self.arguments.init:
            seen = [rollout["inputs"][rollout["active"]] for rollout in rollouts]
            self._network.fit_normalisation(np.concatenate(seen))
        elif not self.arguments.on_policy and not self.is_checkpoint(self.iteration + 1):
            self._drive(self.iteration + 1)
        waited = time.perf_counter()
        learned = self._update(rollouts, [own.last_values for own in driven])
        for own in driven:
            self._recent.extend(own.finishes)
        self.iteration += 1
        steps = int(sum(rollout["active"].sum() for rollout in rollouts))
        self.kart_steps += steps
        end = time.perf_counter()
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            **self._racing_figures(),
            **learned,
            "wait_s": waited - begin,
            "learn_s": end - waited,
            "kart_steps_per_s": steps / (end - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def is_checkpoint(self, iteration: int) -> bool:
        """Whether a checkpoint follows an iteration; all races restart after it."""
        return iteration % self.arguments.checkpoint_every == 0

    def _drive(self, iteration: int) -> None:
        """Lets the actors drive the rollout of an iteration with the current networks."""
        policy, critic = self._network.actor().weights, self._network.critic()
        self._actors.send("drive", [(iteration % 2, policy, critic)] * len(self._actors))

    def _driven(self) -> list[Driven]:
        """Waits for the actors' rollouts."""
        driven: list[Driven] = self._actors.receive()
        return driven

    def _update(
        self, rollouts: Sequence[npt.NDArray[np.void]], last_values: Sequence[FloatArray]
    ) -> dict[str, float]:
        """Runs several epochs of gradient steps on the rollouts; returns figures for the log."""
        arguments, nets = self.arguments, self._network
        gained = [
            advantages_of(rollout, last, arguments.gamma, arguments.gae_lambda)
            for rollout, last in zip(rollouts, last_values, strict=True)
        ]
        rows = [rollout["active"] & rollout["driven"] for rollout in rollouts]
        pairs = zip(rollouts, rows, strict=True)
        seen = np.concatenate([rollout[chosen] for rollout, chosen in pairs])
        advantages = np.concatenate([own[r] for own, r in zip(gained, rows, strict=True)])
        returns = advantages + seen["values"]
        left = max(1.0 - self.kart_steps / arguments.anneal_timesteps, 0.0)
        rate = arguments.learning_rate * max(left, 0.05)
        ent_coef = arguments.ent_coef * max(left, 0.1)
        is_warming = self.iteration < arguments.warm_up
        nets.optimiser.param_groups[0]["lr"] = 0.0 if is_warming else rate
        nets.optimiser.param_groups[1]["lr"] = _VALUE_RATE * rate
        from_numpy = nets.torch.from_numpy
        data = (
            nets.normalised(seen["inputs"]),
            *(from_numpy(seen[name].copy()) for name in ("prior", "choices", "log_probability")),
            from_numpy((advantages - advantages.mean()) / (advantages.std() + 1e-6)),
            from_numpy(returns / VALUE_UNIT),
        )
        figures: dict[str, list[float]] = {}
        epochs = 0
        for _ in range(arguments.n_epochs):
            epochs += 1
            kl = []
            for batch in self._batches(len(seen)):
                found = self._gradient_step([column[batch] for column in data], ent_coef)
                kl.append(found["kl"])
                for name, value in found.items():
                    figures.setdefault(name, []).append(value)
            if np.mean(kl) > arguments.target_kl:
                break
        unexplained = np.var(advantages) / max(float(np.var(returns)), 1e-9)
        return {
            **{name: float(np.mean(values)) for name, values in figures.items()},
            "epochs": epochs,
            "learning_rate": rate,
            "explained": float(1.0 - unexplained),
            "reward": float(sum(rollout["rewards"].sum() for rollout in rollouts) / len(seen)),
        }

    def _batches(self, count: int) -> list[Any]:
        order = self._network.torch.from_numpy(self._random.permutation(count))
        return [rows for rows in order.split(self.arguments.batch_size) if len(rows) > 1]

    def _gradient_step(self, batch: Sequence[Any], ent_coef: float) -> dict[str, float]:
        inputs, prior, choices, old, advantages, returns = batch
        torch, nets, clip = self._network.torch, self._network, self.arguments.clip_range
        log_probability, entropy, prior_kl, values = nets.evaluate(inputs, prior, choices)
        log_ratio = log_probability - old
        ratio = log_ratio.exp()
        clipped = ratio.clamp(1 - clip, 1 + clip)
        objective = torch.minimum(ratio * advantages, clipped * advantages).mean()
        value_loss = (values - returns).square().mean()
        penalty = self.arguments.kl_coef * prior_kl.mean()
        loss = value_loss - objective - ent_coef * entropy.mean() + penalty
        nets.optimiser.zero_grad()
        loss.backward()
        for layers in (nets.policy, nets.value):
            torch.nn.utils.clip_grad_norm_(layers.parameters(), 0.5)
        nets.optimiser.step()
        with torch.no_grad():
            return {
                "kl": float((ratio - 1 - log_ratio).mean()),
                "clip_fraction": float(((ratio - 1).abs() > clip).float().mean()),
                "entropy": float(entropy.mean()),
                "prior_kl": float(prior_kl.mean()),
                "value_loss": float(value_loss),
            }

    def _racing_figures(self) -> dict[str, float]:
        figures = {}
        for name in ("alone", "selfplay", "rivals"):
            own = [end for end in self._recent if _company(end.lineup) == name]
            if not own:
                continue
            finished = [end.ratio for end in own if end.ratio is not None]
            figures[f"{name}_ratio"] = float(np.mean([end.counted_ratio for end in own]))
            figures[f"{name}_finished_ratio"] = float(np.mean(finished)) if finished else 0.0
            figures[f"{name}_unfinished"] = 1.0 - len(finished) / len(own)
            if name == "rivals":
                figures["rivals_rank"] = float(np.mean([end.rank for end in own]))
                figures["rivals_first"] = float(np.mean([end.rank == 1 for end in own]))
        return figures

    # ------------------------------------------------------------------ checkpoints

    def save_checkpoint(self) -> None:
        """Writes ``checkpoint.pt``; call :meth:`begin_races` next, as a resumed run does."""
        facts = {
            "history": self._history,
            "kart_steps": self.kart_steps,
            "iteration": self.iteration,
            "recent": [asdict(finish) for finish in self._recent],
        }
        save_checkpoint(self.folder, facts, {"network": self._network.state()})

    def save_policy(self, path: Path | None = None) -> Path:
        """Writes the current policy, by default to the run's folder; returns its path."""
        path = path or self.folder / f"policy-{self.kart_steps:09d}.safetensors"
        save_weights(path, self._network.actor().weights)
        return path

    def close(self) -> None:
        """Ends all races."""
        self._actors.close()

    def _chapter(self, kart_steps: int = 0) -> dict[str, Any]:
        """Returns the arguments that apply from a number of kart-steps on."""
        rules = asdict(self._rules)
        return {"from": kart_steps, "arguments": asdict(self.arguments), "rules": rules}

    def _restore(self, facts: LearnerFacts, state: dict[str, Any], may_change: bool) -> None:
        self._history = facts.history
        now, last = self._chapter(facts.kart_steps), self._history[-1]
        rules = {name: last.get("rules", {}).get(name) for name in now["rules"]}
        if check_resumed(
            self.folder,
            {**last["arguments"], **rules},
            {**now["arguments"], **now["rules"]},
            ", or --may-change to continue with these",
            may_change=may_change,
        ):
            self._history.append(now)
        self.kart_steps, self.iteration = facts.kart_steps, facts.iteration
        self._recent.extend(facts.recent)
        with reading_checkpoint(self.folder):
            self._network.restore(state["network"])


def _plan_rules(arguments: SelfPlayArguments) -> DriverParameters:
    """Returns the parameters of the plans."""
    rules, hold = plan_parameters(arguments.plans), arguments.turn_hold
    if hold is None:
        return rules
    return replace(rules, turn_hold=check_whole("turn_hold", hold, 1))


def _company(lineup: Lineup) -> str:
    """Returns which opponents the learners of a race meet."""
    return "rivals" if lineup.bots else "selfplay" if lineup.learners > 1 else "alone"


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class SelfPlayOptions(ScriptOptions):
    """Options of the command.

    Attributes:
        total_timesteps: total kart-steps to train for.
        may_change: continue even if the arguments differ; arguments.json records both.
    """

    total_timesteps: int = option(required=True)
    may_change: bool = False


def train(options: SelfPlayOptions, arguments: SelfPlayArguments) -> None:
    """Starts or continues a run.

    Raises:
        ConfigError: see :class:`PPOLearner`.
    """
    learner = PPOLearner(options.output, arguments, may_change=options.may_change)
    total = options.total_timesteps
    with (
        closing(learner),
        TrainingLog(learner.folder, learner.iteration) as log,
        ProgressBar(total, learner.kart_steps) as bar,
    ):
        while learner.kart_steps < total:
            before = learner.kart_steps
            line = learner.iterate()
            log.write(line)
            bar.report(learner.kart_steps, _summary(line))
            if learner.kart_steps // arguments.keep_every > before // arguments.keep_every:
                learner.save_policy()
            if learner.is_checkpoint(learner.iteration):
                learner.save_checkpoint()
                learner.begin_races()
        learner.save_checkpoint()
        learner.save_policy()


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    kinds = SelfPlayOptions, SelfPlayArguments
    remedy = "the same command continues from the last checkpoint"
    return run_command("ppo.selfplay", __doc__, train, kinds, words, remedy)


_SHOWN = (
    "alone_ratio",
    "selfplay_ratio",
    "rivals_ratio",
    "rivals_rank",
    "entropy",
    "kl",
    "explained",
)


def _summary(line: dict[str, float]) -> str:
    figures = [f"{name} {line[name]:.3f}" for name in _SHOWN if name in line]
    speed = line["kart_steps_per_s"]
    return f"{'  '.join(figures)}  {speed:.0f}/s"


if __name__ == "__main__":
    sys.exit(main())
