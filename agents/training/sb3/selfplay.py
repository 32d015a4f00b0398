"""Trains a policy from scratch by self-play with Stable-Baselines3's PPO.

    python -m stkzoo.agents.training.sb3.selfplay --output runs/first --total-timesteps 2000000

One policy sees the view ``racing`` and drives the agents of several races. In half of the races,
one of its past selves drives half of these karts; hard opponents are drawn more often. The game's
AI drives the other karts. A curriculum opens more tracks, directions and difficulties as the policy
gets faster. The reward is the distance driven plus places gained.

    --init FILE     start from the weights of another run, or of imitation
    --races 4+1x5   five races of four agents and one bot

To continue a run that was killed, run the same command again. Training consists of rounds. Each
round starts with new races and its own seeds and ends with a checkpoint, so that the run continues
bit for bit. The folder contains ``checkpoint.pt``, ``log.jsonl`` (one line per update),
``arguments.json``, TensorBoard files, ``policy-STEPS.safetensors``, and ``agent``, which ``stkzoo
race`` accepts:

    tensorboard --logdir runs
    python -m stkzoo.agents.training.plot runs/first
    python -m stkzoo.agents.training.rate runs/first --every 0 --output ratings
    stkzoo race runs/first/agent ai ai random --track lighthouse
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo._arguments import option
from stkzoo._locks import locked_folder
from stkzoo._schema import Count, Share
from stkzoo.agents.pretrained.mlp import HOLD
from stkzoo.errors import ConfigError

try:
    from stkzoo.sb3 import ActiveRolloutBuffer
except ImportError as error:
    if __name__ == "__main__":
        sys.exit(f"error: {error}")
    raise

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger

from ..common.arguments import (
    Coefficient,
    Lineup,
    Natural,
    PPOArguments,
    ScriptOptions,
    parse_races,
)
from ..common.command import ProgressBar, run_command
from ..common.run_folder import (
    TrainingLog,
    keep_arguments,
    load_checkpoint,
    policy_name,
    reading_checkpoint,
    save_checkpoint,
    save_driver,
)
from ..export import export_policy
from ..ppo.network import FIRST_BIASES, racing_weights
from ..ppo.opponents import PRIORITIZED, DuelResults, Matchmaker
from .curriculum import EASY_TO_HARD, Curriculum, CurriculumState
from .races import SelfPlayVecEnv

#: Arguments that have the same name in Stable-Baselines3's PPO.
_PPO_NAMES = {entry.name for entry in fields(PPOArguments)} - {"hidden"}


# ---------------------------------------------------------------------- arguments


@dataclass(frozen=True, slots=True)
class SB3Arguments(PPOArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        races: 4+1x5 is five races of four agents and one bot.
        tracks: tracks from easy to hard, or a split, such as train_only.
        pass_at: pace, relative to the AI's in such races, at which the next stage begins.
        snapshot_share: fraction of races in which a past self drives half of the agents' karts.
        grid_share: fraction of starts on the grid; the others are anywhere on the track.
        num_starts: number of different starts in a round; its later races copy one of them, which
            takes a tenth of the time. 0 makes a new start for each race, as is necessary on other
            systems than Linux.
        pool_size: number of past selves to keep as opponents.
        init: weights to start from; empty starts from scratch.
        n_steps: steps of each race between two updates.
        updates: updates per round; each round ends with a checkpoint.
        hold: minimum steps of a drift; a drift earns a boost after 11 steps.
        warm_up: kart-steps at the start that train only the value network; for runs with --init.
        decay_timesteps: learning rate and entropy coefficient decay as 1 / sqrt(1 + kart-steps /
            this); 0 keeps them constant.
        keep_every: kart-steps between two past selves.
    """

    learning_rate: float = 5e-4
    n_epochs: int = 3
    ent_coef: Coefficient = 0.003
    races: str = "4+1x5"
    tracks: tuple[str, ...] = option(EASY_TO_HARD, flag="--track", metavar="TRACK")
    pass_at: float = 0.7
    snapshot_share: Share = 0.5
    grid_share: Share = 0.3
    num_starts: Natural = 20
    pool_size: int = 12
    init: str = ""
    n_steps: int = 128
    updates: int = 32
    hold: Natural = 11
    warm_up: Natural = 0
    decay_timesteps: Natural = 1_000_000
    keep_every: int = 50_000

    def __post_init__(self) -> None:
        names = self.tracks
        PPOArguments.__post_init__(self)
        if self.n_steps * self.lineup.learners * self.lineup.races < 2:
            raise ConfigError("n_steps is 1 in a race of one agent, expected 2 or more steps")
        if names != self.tracks:  # a split, whose tracks are in alphabetical order
            ordered = (track for track in EASY_TO_HARD if track in self.tracks)
            others = (track for track in self.tracks if track not in EASY_TO_HARD)
            object.__setattr__(self, "tracks", (*ordered, *others))

    @property
    def lineup(self) -> Lineup:
        """The parallel races."""
        return parse_races([self.races])[0]


# ---------------------------------------------------------------------- the run


@dataclass(frozen=True, slots=True)
class SB3Facts:
    """The facts in a checkpoint."""

    kart_steps: Count
    iteration: Count
    curriculum: CurriculumState
    duels: DuelResults
    recent: list[dict[str, float]]


class SB3Run:
    """A run: its races, model and files.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.

    Raises:
        ConfigError: an argument is invalid, or the folder contains another run or is used by
            another program.
    """

    def __init__(self, folder: str | Path, arguments: SB3Arguments) -> None:
        self.folder, self.arguments = Path(folder), arguments
        with ExitStack() as resources:
            resources.enter_context(locked_folder(self.folder, "run"))
            remedy = " (with --init to start from this run's weights)"
            keep_arguments(self.folder, arguments, remedy=remedy)
            self.kart_steps = self.iteration = 0
            self._curriculum = Curriculum(arguments.tracks, arguments.pass_at)
            self._matchmaker = Matchmaker(
                PRIORITIZED, arguments.pool_size, arguments.snapshot_share
            )
            self._envs = SelfPlayVecEnv(
                arguments.lineup,
                self._curriculum,
                self._matchmaker,
                self.folder,
                grid_share=arguments.grid_share,
                num_starts=arguments.num_starts,
                hold=arguments.hold,
            )
            resources.callback(self._envs.close)
            self._model = self._make_model()
            if checkpoint := load_checkpoint(self.folder, SB3Facts):
                with reading_checkpoint(self.folder):
                    self._restore(*checkpoint)
            else:
                if arguments.init:
                    weights = racing_weights(arguments.init, arguments.hidden)
                    policy = self._model.policy
                    policy.load_state_dict(initial_state(weights, policy))
                self._keep()
                self.save_checkpoint()
            self._resources = resources.pop_all()

    def play_round(self, report: Callable[[dict[str, float]], None]) -> None:
        """Trains for a round, saves the policy if it is due, and writes the checkpoint.

        All random numbers derive from the run's seed and the round's number.

        Args:
            report: called with the log entry of each update.
        """
        arguments, model = self.arguments, self._model
        before = self.kart_steps
        model.set_env(self._envs, force_reset=True)
        number = self.iteration // arguments.updates
        (seed,) = np.random.SeedSequence([arguments.seed, number]).generate_state(1)
        model.set_random_seed(int(seed))
        for _ in range(arguments.updates):
            report(self._update())
        if self.kart_steps // arguments.keep_every > before // arguments.keep_every:
            self._matchmaker.add(self._keep())
        self.save_checkpoint()

    def save_checkpoint(self) -> None:
        """Writes ``checkpoint.pt``, from which the run continues exactly."""
        facts = {
            "kart_steps": self.kart_steps,
            "iteration": self.iteration,
            "curriculum": self._curriculum.state(),
            "duels": self._matchmaker.state(),
            "recent": list(self._envs.recent),
        }
        policy = self._model.policy
        state = {"policy": policy.state_dict(), "optimizer": policy.optimizer.state_dict()}
        save_checkpoint(self.folder, facts, state)

    def save_agent(self) -> Path:
        """Saves the policy, also as an agent; returns the agent's folder."""
        self._keep()  # other scripts take the newest of the saved policies
        file = self.folder / "policy.safetensors"
        save_driver(file, arrays_of(self._model.policy), self.arguments.hold)
        return export_policy(file, f"selfplay_{self.kart_steps}", self.folder / "agent")

    def close(self) -> None:
        """Ends all races, and unlocks the folder."""
        self._resources.close()

    # ------------------------------------------------------------------ parts

    def _make_model(self) -> Any:
        arguments = self.arguments
        torch.set_num_threads(1)  # the network is small; leave the cores to the races
        with warnings.catch_warnings():
            # Batches may differ in size: the buffer leaves out idle slots.
            warnings.filterwarnings("ignore", "You have specified a mini-batch size")
            model: Any = PPO(
                "MlpPolicy",
                self._envs,
                rollout_buffer_class=ActiveRolloutBuffer,
                n_steps=arguments.n_steps,
                policy_kwargs={"net_arch": list(arguments.hidden)},
                device="cpu",
                **{name: getattr(arguments, name) for name in _PPO_NAMES},
            )
        with torch.no_grad():
            for choice, bias in FIRST_BIASES.items():
                model.policy.action_net.bias[choice] += bias
        model.set_logger(Logger(None, []))
        return model

    def _update(self) -> dict[str, float]:
        """Runs one update; returns its log entry."""
        begin, envs = time.perf_counter(), self._envs
        before = envs.kart_steps, envs.rewarded
        self._anneal()
        self._warm_up()
        size = self.arguments.n_steps * envs.num_envs
        self._model.learn(size, reset_num_timesteps=False, log_interval=None)
        driven, rewarded = envs.kart_steps - before[0], envs.rewarded - before[1]
        self.kart_steps += driven
        self.iteration += 1
        logged = self._model.logger.name_to_value
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            "stage": self._curriculum.stage,
            "rivals": len(self._matchmaker.pool),
            "reward": rewarded / max(driven, 1),
            **envs.figures(),
            **self._matchmaker.figures(),
            **{
                short: sign * float(logged[name])
                for short, sign, name in (
                    ("kl", 1, "train/approx_kl"),
                    ("entropy", -1, "train/entropy_loss"),
                    ("value_loss", 1, "train/value_loss"),
                    ("learning_rate", 1, "train/learning_rate"),
                )
                if name in logged
            },
            "explained": _explained(self._model.rollout_buffer),
            "kart_steps_per_s": driven / (time.perf_counter() - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def _anneal(self) -> None:
        """Sets the decayed learning rate and entropy coefficient."""
        arguments = self.arguments
        passed = self.kart_steps / arguments.decay_timesteps if arguments.decay_timesteps else 0.0
        share = (1.0 + passed) ** -0.5
        self._model.lr_schedule = lambda _: share * arguments.learning_rate
        self._model.ent_coef = share * arguments.ent_coef

    def _warm_up(self) -> None:
        """Freezes the policy during the warm-up of the value network."""
        policy = self._model.policy
        for part in (policy.mlp_extractor.policy_net, policy.action_net):
            part.requires_grad_(self.kart_steps >= self.arguments.warm_up)

    def _keep(self) -> str:
        """Writes the current policy; returns its name."""
        name = policy_name(self.kart_steps)
        file = self.folder / f"{name}.safetensors"
        save_driver(file, arrays_of(self._model.policy), self.arguments.hold)
        return name

    def _restore(self, facts: SB3Facts, state: dict[str, Any]) -> None:
        self.kart_steps, self.iteration = facts.kart_steps, facts.iteration
        self._curriculum.restore(facts.curriculum)
        self._matchmaker.restore(facts.duels)
        self._envs.recent.extend(facts.recent)
        self._model.policy.load_state_dict(state["policy"])
        self._model.policy.optimizer.load_state_dict(state["optimizer"])


def _explained(buffer: Any) -> float:
    """Returns the explained variance of the returns, without idle steps."""
    values, returns = (a.reshape(-1)[buffer.active] for a in (buffer.values, buffer.returns))
    return float(1.0 - np.var(returns - values) / max(np.var(returns), 1e-8))


def arrays_of(policy: Any) -> dict[str, npt.NDArray[np.float32]]:
    """Returns the state dict of a policy as arrays."""
    return {name: value.detach().cpu().numpy() for name, value in policy.state_dict().items()}


def initial_state(weights: dict[str, npt.NDArray[np.float32]], policy: Any) -> dict[str, Any]:
    """Returns a state dict for a policy from weights, which may lack the value network.

    If the layers take only the view as input, the memory of the action filter initially has no
    effect.

    Args:
        weights: weights from ``sb3``, ``imitation`` or ``rllib``, with the policy's hidden layers.
        policy: the Stable-Baselines3 policy to initialize.
    """
    state = arrays_of(policy)
    for name, array in weights.items():
        more = state[name].shape[-1] - array.shape[-1] if name in state else 0
        if name != HOLD:
            state[name] = np.pad(array, ((0, 0), (0, more))) if more else array
    return {name: torch.from_numpy(array) for name, array in state.items()}


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class SB3Options(ScriptOptions):
    """Options of the command.

    Attributes:
        total_timesteps: total kart-steps.
    """

    total_timesteps: int = 10_000_000


def train(options: SB3Options, arguments: SB3Arguments) -> None:
    """Starts or continues a run.

    Raises:
        ConfigError: see :class:`SB3Run`.
    """
    with (
        closing(SB3Run(options.output, arguments)) as run,
        TrainingLog(run.folder, run.iteration) as log,
    ):
        with ProgressBar(options.total_timesteps, run.kart_steps) as bar:

            def report(line: dict[str, float]) -> None:
                log.write(line)
                show = bar.report if run.iteration % arguments.updates == 0 else bar.show
                show(line["kart_steps"], _summary(line))

            while run.kart_steps < options.total_timesteps:
                run.play_round(report)
        agent = run.save_agent()
        print(f"stkzoo race {agent} ai ai random --track {arguments.tracks[0]}")


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    remedy = "the same command continues from the last round"
    return run_command("sb3.selfplay", __doc__, train, (SB3Options, SB3Arguments), words, remedy)


def _summary(line: dict[str, float]) -> str:
    """Returns a short text on an update."""
    names = ("pace", "finished", "position", "beaten")
    figures = [f"{name} {line[name]:.2f}" for name in names if name in line]
    return f"stage {line['stage']:.0f}  {'  '.join(figures)}  {line['kart_steps_per_s']:.0f}/s"


if __name__ == "__main__":
    sys.exit(main())
