"""Learns to race from nothing, by self-play with Stable-Baselines3's PPO.

    python -m stkzoo.agents.training.sb3.selfplay --output runs/first --minutes 10

One policy sees the view ``racing`` and drives the agents of several races. In half of the races
without bots, half of the karts are driven by one of its past selves, the hard ones more often; in
the races with bots, by the game's AI of a difficulty drawn in the same way. A curriculum opens
more tracks, directions and difficulties as it gets faster. The reward is the way and the places
won.

    --minutes 10              stop after so long; the same command goes on from there
    --until 2000000           or after so many kart-steps in all
    --start FILE              begin with the weights of another run, or of imitation
    --races 4x4 2+2x2         four races of four agents, two of two agents and two bots
    --supersuit               the same through SuperSuit: plain self-play, for comparison

Killed? The same command. Training is cut into rounds; each begins with new races and its own
seeds, and ends with a checkpoint, so that the curve goes on exactly as it would have. In the
folder: ``checkpoint.pt``, ``log.jsonl`` (a line an update), ``arguments.json``, TensorBoard's
files, ``policy-STEPS.safetensors``, ``evaluations`` (races of kept policies, driven in a process
beside the training), ``ratings.json``, and ``agent``, which ``stkzoo race`` takes:

    tensorboard --logdir runs
    python -m stkzoo.agents.training.sb3.plot runs/first
    stkzoo race runs/first/agent ai ai random --track lighthouse
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stkzoo._os import atomic_write
from stkzoo.agents.pretrained.mlp import load_driver
from stkzoo.errors import ConfigError, StkzooError
from stkzoo.evaluation.ratings import require_openskill
from stkzoo.wrappers.racing import CHOICES, RESCUE

from ..common.arguments import ARGUMENTS, RunBar, add_arguments, changes, values_of
from ..common.opponents import Pool
from ..common.training_log import Journal
from .curriculum import EASY_TO_HARD, Curriculum
from .policy import save_driver, start_weights, write_agent

__all__ = ["Arguments", "Run", "main"]

_CHECKPOINT, _AGENT = "checkpoint.pt", "agent"
#: What a policy that knows nothing leans towards, by the place among the view's choices: to go
#: rather than to brake, and to drift or call for the rescue now and then only. Without it
#: every kart stands for most of its first races.
_LEANINGS = {CHOICES[0]: 1.5, CHOICES[0] + RESCUE: -3.0, sum(CHOICES[:2]): 2.0}
#: Karts whose races the log's figures are means of.
_RECENT = 100
#: How long the last evaluations may take [s].
_LAST_EVALUATIONS = 1800.0


@dataclass(frozen=True, slots=True)
class Arguments:
    """What a run is made of; kept with it, and it goes on with the same only.

    Attributes:
        seed: of everything.
        races: groups of races alike.
        tracks: from easy to hard.
        pass_at: the next stage begins at this pace, as a share of the AI's in such races.
        share: of races without bots in which a snapshot drives half of the karts.
        grid: share of races that begin on the grid; the others begin anywhere.
        pool: how many snapshots are kept as rivals.
        start: weights to begin with; empty begins from nothing.
        hidden: units of the layers.
        steps: of every race between two updates.
        updates: of a round, after which there is a checkpoint.
        minibatch: kart-steps of a gradient.
        epochs: how often an update goes over what was seen.
        learning_rate: of the optimiser at the start.
        gamma: discount of a step.
        trace: lambda of the advantage.
        clip: how far a probability may move in one update, as a share.
        entropy: bonus at the start.
        hold: for how many steps a drift is held; it pays after 11.
        warm_up: kart-steps from which only values are learned; for those who --start as drivers.
        fade: learning rate and entropy bonus are over sqrt(1 + kart-steps / fade); 0 keeps them.
        keep_every: kart-steps between two snapshots.
        evaluate_every: kart-steps between two evaluations.
        evaluation_races: of each; 0 evaluates nothing.
        evaluation_tracks: driven in turn.
        supersuit: through SuperSuit instead: plain self-play.
    """

    seed: int = 0
    races: tuple[str, ...] = ("4x4", "2+2x2")
    tracks: tuple[str, ...] = EASY_TO_HARD
    pass_at: float = 0.7
    share: float = 0.5
    grid: float = 0.3
    pool: int = 12
    start: str = ""
    hidden: tuple[int, ...] = (256, 128)
    steps: int = 128
    updates: int = 16
    minibatch: int = 512
    epochs: int = 4
    learning_rate: float = 5e-4
    gamma: float = 0.98
    trace: float = 0.95
    clip: float = 0.2
    entropy: float = 0.003
    hold: int = 11
    warm_up: int = 0
    fade: int = 1_000_000
    keep_every: int = 50_000
    evaluate_every: int = 100_000
    evaluation_races: int = 6
    evaluation_tracks: tuple[str, ...] = EASY_TO_HARD[:3]
    supersuit: bool = False


class Run:
    """A run: its races, model and files.

    Args:
        folder: where it is kept.
        arguments: what it is made of.

    Raises:
        ConfigError: something is missing, cannot be, or is not what the folder's run is made of.
    """

    def __init__(self, folder: str | Path, arguments: Arguments) -> None:
        self._torch = _library("torch")
        _library("stable_baselines3")
        require_openskill()
        evaluation = importlib.import_module("stkzoo.agents.training.sb3.evaluation")
        self.folder, self.arguments = Path(folder), arguments
        self.folder.mkdir(parents=True, exist_ok=True)
        self.kart_steps = self.iteration = self.rounds = 0
        self._curriculum = Curriculum(arguments.tracks, arguments.pass_at)
        self._bots, self._snapshots = Pool(4), Pool(arguments.pool)
        for difficulty in range(4):
            self._bots.add(f"bot:{difficulty}")
        self._recent: deque[Any] = deque(maxlen=_RECENT)
        self._envs = self._make_races()
        self._model = self._make_model()
        self.judge = evaluation.BackgroundJudge(
            self.folder, arguments.evaluation_tracks, arguments.evaluation_races
        )
        if (self.folder / _CHECKPOINT).exists():
            self._restore()
        else:
            if arguments.start:
                self._load(start_weights(arguments.start, self._model.policy))
            self._keep(is_rival=False)
            self._evaluate_if_due(-1)
            self.save_checkpoint()
        with atomic_write(self.folder / ARGUMENTS) as part:
            part.write_text(json.dumps(asdict(arguments), indent=1) + "\n")

    def play_round(self, tell: Callable[[dict[str, float]], None]) -> None:
        """Plays and learns a round, keeps what is to be kept, and writes the checkpoint.

        All chance comes from the run's seed and the round's number.

        Args:
            tell: gets each update's line of the log.
        """
        arguments, model = self.arguments, self._model
        before = self.kart_steps
        model.set_env(self._envs, force_reset=True)
        model.set_random_seed(_seed(arguments.seed, self.rounds))
        for _ in range(arguments.updates):
            tell(self._update())
        self.rounds += 1
        if self.kart_steps // arguments.keep_every > before // arguments.keep_every:
            self._keep(is_rival=True)
        self._evaluate_if_due(before)
        self.save_checkpoint()

    def save_checkpoint(self) -> None:
        """Writes ``checkpoint.pt``, from which the run goes on exactly."""
        facts = {
            "arguments": asdict(self.arguments),
            "kart_steps": self.kart_steps,
            "iteration": self.iteration,
            "rounds": self.rounds,
            "curriculum": self._curriculum.state(),
            "bots": self._bots.state(),
            "snapshots": self._snapshots.state(),
            "recent": [asdict(end) for end in self._recent],
        }
        state = {
            "facts": json.dumps(facts),
            "policy": self._model.policy.state_dict(),
            "optimiser": self._model.policy.optimizer.state_dict(),
        }
        with atomic_write(self.folder / _CHECKPOINT) as part:
            self._torch.save(state, part)

    def save_agent(self) -> Path:
        """Writes the policy as an agent to race; its folder."""
        name = f"self-play {self.kart_steps:,}"
        return write_agent(self.folder / _AGENT, self._model.policy, name, self._held)

    def close(self) -> None:
        """Ends all races."""
        self.judge.close()
        self._envs.close()

    # ------------------------------------------------------------------ parts

    @property
    def _held(self) -> int:
        return 0 if self.arguments.supersuit else self.arguments.hold

    def _make_races(self) -> Any:
        races = importlib.import_module("stkzoo.agents.training.sb3.races")
        groups = races.race_groups(self.arguments.races)
        if self.arguments.supersuit:
            _library("supersuit")
            other = importlib.import_module("stkzoo.agents.training.sb3.supersuit")
            return other.SuperSuitRaces(groups[0], self.arguments.tracks[:1])
        return races.SelfPlayVecEnv(
            groups,
            self._curriculum,
            self._bots,
            self._snapshots,
            share=self.arguments.share,
            grid=self.arguments.grid,
            hold=self._held,
        )

    def _make_model(self) -> Any:
        arguments = self.arguments
        sb3 = importlib.import_module("stable_baselines3")
        logger = importlib.import_module("stable_baselines3.common.logger")
        buffers = importlib.import_module("stkzoo.sb3")
        self._torch.set_num_threads(1)  # a small network; the cores are for the races
        with warnings.catch_warnings():
            # Minibatches need not be of one size: the buffer leaves out who idles.
            warnings.filterwarnings("ignore", "You have specified a mini-batch size")
            model = sb3.PPO(
                "MlpPolicy",
                self._envs,
                rollout_buffer_class=buffers.ActiveRolloutBuffer,
                n_steps=arguments.steps,
                batch_size=arguments.minibatch,
                n_epochs=arguments.epochs,
                learning_rate=arguments.learning_rate,
                gamma=arguments.gamma,
                gae_lambda=arguments.trace,
                clip_range=arguments.clip,
                ent_coef=arguments.entropy,
                policy_kwargs={"net_arch": list(arguments.hidden)},
                seed=arguments.seed,
                device="cpu",
            )
        with self._torch.no_grad():
            for choice, leaning in _LEANINGS.items():
                model.policy.action_net.bias[choice] += leaning
        model.set_logger(logger.Logger(None, []))
        return model

    def _update(self) -> dict[str, float]:
        """One update: its line of the log."""
        begin, envs = time.perf_counter(), self._envs
        before = envs.kart_steps, envs.rewarded
        self._fade()
        self._warm_up()
        size = self.arguments.steps * envs.num_envs
        self._model.learn(size, reset_num_timesteps=False, log_interval=None)
        driven, rewarded = envs.kart_steps - before[0], envs.rewarded - before[1]
        self.kart_steps += driven
        self.iteration += 1
        self._recent.extend(envs.ends)
        envs.ends.clear()
        logged = self._model.logger.name_to_value
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            "stage": self._curriculum.stage,
            "rivals": len(self._snapshots.rivals),
            "reward": rewarded / max(driven, 1),
            **self._racing_figures(),
            **{
                short: float(logged[name])
                for short, name in (
                    ("kl", "train/approx_kl"),
                    ("entropy", "train/entropy_loss"),
                    ("value_loss", "train/value_loss"),
                    ("learning_rate", "train/learning_rate"),
                )
                if name in logged
            },
            "explained": _explained(self._model.rollout_buffer),
            "kart_steps_per_s": driven / (time.perf_counter() - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def _fade(self) -> None:
        """Sets learning rate and entropy bonus, which fall so that the policy settles."""
        arguments = self.arguments
        passed = self.kart_steps / arguments.fade if arguments.fade else 0.0
        share = (1.0 + passed) ** -0.5
        self._model.lr_schedule = lambda _: share * arguments.learning_rate
        self._model.ent_coef = share * arguments.entropy

    def _warm_up(self) -> None:
        """Keeps the policy as it is while values know nothing."""
        policy = self._model.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net):
            part.requires_grad_(self.kart_steps >= self.arguments.warm_up)

    def _racing_figures(self) -> dict[str, float]:
        if not self._recent:
            return {}
        figures = {
            "pace": float(np.mean([end.pace for end in self._recent])),
            "finished": float(np.mean([end.finished for end in self._recent])),
        }
        for name, is_wanted in (("beats_bots", True), ("beats_past", False)):
            duels = [
                end.beaten
                for end in self._recent
                if end.rival and end.rival.startswith("bot:") == is_wanted
            ]
            if duels:
                figures[name] = float(np.mean(duels))
        return figures

    def _keep(self, *, is_rival: bool) -> None:
        """Writes the policy as it is now, and makes it one of the rivals."""
        name = self._policy_name()
        file = self.folder / f"{name}.safetensors"
        save_driver(file, self._model.policy, self._held)
        if is_rival and not self.arguments.supersuit:
            self._snapshots.add(name)
            self._make_ready(name)

    def _make_ready(self, name: str) -> None:
        path = self.folder / f"{name}.safetensors"
        self._envs.add_driver(name, load_driver(path))

    def _policy_name(self) -> str:
        return f"policy-{self.kart_steps:09d}"

    def _evaluate_if_due(self, before: int) -> None:
        """Has the policy judged if a multiple of ``evaluate_every`` has been passed."""
        every = self.arguments.evaluate_every
        if self.arguments.evaluation_races and self.kart_steps // every > before // every:
            if not (self.folder / f"{self._policy_name()}.safetensors").exists():
                self._keep(is_rival=False)
            self.judge.ask(self._policy_name())

    def _load(self, weights: dict[str, Any]) -> None:
        tensors = {name: self._torch.from_numpy(array) for name, array in weights.items()}
        self._model.policy.load_state_dict(tensors)

    def _restore(self) -> None:
        state = self._torch.load(self.folder / _CHECKPOINT, weights_only=True)
        facts = json.loads(state["facts"])
        told = changes(facts["arguments"], asdict(self.arguments))
        if told:
            raise ConfigError(
                f"the run in {str(self.folder)!r} has other arguments: {told}; give the same, or "
                "another --output (with --start to begin with this run's weights)"
            )
        self.kart_steps, self.iteration = facts["kart_steps"], facts["iteration"]
        self.rounds = facts["rounds"]
        self._curriculum.restore(facts["curriculum"])
        self._bots.restore(facts["bots"])
        self._snapshots.restore(facts["snapshots"])
        ends = importlib.import_module("stkzoo.agents.training.sb3.races").RaceEnd
        self._recent.extend(ends(**end) for end in facts["recent"])
        self._model.policy.load_state_dict(state["policy"])
        self._model.policy.optimizer.load_state_dict(state["optimiser"])
        for rival in self._snapshots.rivals:
            self._make_ready(rival.name)
        self._ask_again()

    def _ask_again(self) -> None:
        """Has those judged that were to be, when the program ended."""
        if not self.arguments.evaluation_races:
            return
        last = -1
        for path in sorted(self.folder.glob("policy-*.safetensors")):
            steps = int(path.stem.removeprefix("policy-"))
            every = self.arguments.evaluate_every
            if last // every < steps // every and steps <= self.kart_steps:
                self.judge.ask(path.stem)
            last = steps


def _explained(buffer: Any) -> float:
    """The share of the returns' variance that the values foresaw, without idle steps."""
    values, returns = (a.reshape(-1)[buffer.active] for a in (buffer.values, buffer.returns))
    return float(1.0 - np.var(returns - values) / max(np.var(returns), 1e-8))


def _seed(seed: int, number: int) -> int:
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ConfigError(
            f"learning needs {name} ({error}); pip install 'stkzoo[sb3,train,tournament]'"
        ) from error


def _text(line: dict[str, float]) -> str:
    """An update in a few words."""
    names = ("pace", "finished", "beats_past", "beats_bots")
    figures = [f"{name.replace('_', ' ')} {line[name]:.2f}" for name in names if name in line]
    return f"stage {line['stage']:.0f}  {'  '.join(figures)}  {line['kart_steps_per_s']:.0f}/s"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m stkzoo.agents.training.sb3.selfplay",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--output", required=True, help="the run's folder")
    parser.add_argument("--until", type=int, default=10_000_000, help="kart-steps in all")
    parser.add_argument("--minutes", type=float, help="stop after so long, at the round's end")
    add_arguments(parser, Arguments)
    return parser


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    options = vars(_parser().parse_args(words))
    folder, until, minutes = (options.pop(name) for name in ("output", "until", "minutes"))
    try:
        run = Run(folder, Arguments(**values_of(options)))
    except StkzooError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    journal = Journal(run.folder, run.iteration)
    bar = RunBar(until, run.kart_steps)
    try:
        _play(run, journal, bar, until, minutes)
        bar.stop()
        _finish(run, journal)
    except KeyboardInterrupt:
        bar.stop()
        print("interrupted; the same command goes on from the last round", file=sys.stderr)
        return 130
    finally:
        bar.stop()
        journal.close()
        run.close()
    return 0


def _play(run: Run, journal: Journal, bar: RunBar, until: int, minutes: float | None) -> None:
    begin, updates = time.monotonic(), run.arguments.updates

    def tell(line: dict[str, float]) -> None:
        journal.write(line)
        bar.show(line["kart_steps"], _text(line))
        if run.iteration % updates == 0 and not bar.is_shown:
            print(f"{line['kart_steps']:>10,.0f}  {_text(line)}", flush=True)
        _write_judgements(run, journal)

    while run.kart_steps < until:
        run.play_round(tell)
        if minutes is not None and time.monotonic() - begin > 60 * minutes:
            break


def _write_judgements(run: Run, journal: Journal, wait: float = 0.0) -> None:
    """Adds evaluations that have come in to TensorBoard's files."""
    if not (run.judge.finish(wait) if wait else run.judge.poll()):
        return
    file = run.folder / "ratings.json"
    latest = json.loads(file.read_text())["policies"][-1]
    for name in ("rating", "rating_low", "rating_high", "time_ratio"):
        journal.add(f"evaluation/{name}", latest[name], latest["kart_steps"])


def _finish(run: Run, journal: Journal) -> None:
    """Writes the agent, waits for the evaluations, and says what came of it all."""
    agent = run.save_agent()
    if run.judge.is_busy:
        print("the last evaluations ...", file=sys.stderr, flush=True)
    begin = time.monotonic()
    while run.judge.is_busy and time.monotonic() - begin < _LAST_EVALUATIONS:
        _write_judgements(run, journal, wait=1.0)
    if run.judge.failures:
        print(f"{run.judge.failures} evaluations failed; see above", file=sys.stderr)
    file = run.folder / "ratings.json"
    if file.exists():
        for row in json.loads(file.read_text())["table"]:
            print(row)
    print(f"stkzoo race {agent} ai ai random --track {run.arguments.tracks[0]}")


if __name__ == "__main__":
    sys.exit(main())
