"""Trains a policy from scratch by self-play with Stable-Baselines3's PPO.

    python -m stkzoo.agents.training.sb3.selfplay --output runs/first --total-timesteps 2000000

One policy sees the view ``racing`` and drives the agents of several races. In half of the races,
one of its past selves drives half of these karts; hard opponents are drawn more often. Half of the
races are on any track, the others more often on tracks where the policy is slow. Half of the races
start on the grid; the others start anywhere on the tracks and are short. Half of the karts, drawn
for each race, drive mirrored left to right. The reward is the distance driven plus places gained.

    --init FILE     start from the weights of another run, or of imitation
    --races 4+1x5   five races of four agents and one bot, which the game's AI drives

To continue a run, also after a kill, run the same command again, perhaps with more
``--total-timesteps``. The run continues bit for bit, because all races restart after a checkpoint.
The folder contains ``checkpoint.pt``, ``log.jsonl`` (one line per update), ``arguments.json``,
TensorBoard files, ``policy-STEPS.safetensors``, and ``agent``, which ``stkzoo race`` accepts:

    tensorboard --logdir runs
    python -m stkzoo.agents.training.plot runs/first
    python -m stkzoo.agents.training.evaluate runs/first/policy-*.safetensors
    stkzoo race runs/first/agent ai ai random --track lighthouse
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from stkzoo import Reward
from stkzoo._arguments import option
from stkzoo._schema import Level, Share
from stkzoo.agents.planning import FloatArray
from stkzoo.agents.planning.mirrored import MirroredRaces
from stkzoo.agents.planning.motion import STEP
from stkzoo.agents.pretrained.action_filter import INPUT_SIZE
from stkzoo.agents.pretrained.mlp import MlpDriver, load_driver
from stkzoo.errors import ConfigError
from stkzoo.mdp import rewards

try:
    from stkzoo.sb3 import ActiveRolloutBuffer, RaceVecEnv
except ImportError as error:
    if __name__ == "__main__":
        sys.exit(f"error: {error}")
    raise

from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import explained_variance
from torch.distributions import Distribution

from ..common.arguments import (
    QUICK_TRACKS,
    Coefficient,
    LearnerArguments,
    Natural,
    PPOArguments,
    ScriptOptions,
    parse_races,
)
from ..common.command import run_command
from ..common.filtered import FilteredView
from ..common.matches import ai_time
from ..export import export_policy
from ..ppo.network import RacingNetwork, racing_weights
from ..ppo.opponents import PRIORITIZED, Matchmaker, RivalSeats, draw_opponent
from ..ppo.rollouts import MIRROR_SHARE, ActorRaces, KartRace
from ..ppo.run import PPOSetup, TrainingRun, race_figures

#: Arguments that have the same name in Stable-Baselines3's PPO.
_PPO_NAMES = {entry.name for entry in fields(PPOArguments)} - {"hidden"} | {"n_steps"}
#: 0.1 per meter driven, and 0.3 per place gained.
_REWARD = Reward(
    {"advance": rewards.advance, "places": rewards.overtaking}, {"places": 0.3}, {"advance": 5.0}
)
#: Options of the races on the grid, which are long enough for a lap.
_GRID: dict[str, Any] = {"start": None, "max_cycles": 1200}
#: Figures of the log to show.
_SHOWN = ("pace", "finished", "position", "beaten")


# ---------------------------------------------------------------------- arguments


@dataclass(frozen=True, slots=True)
class SB3Arguments(LearnerArguments):
    """Arguments of a run; they must not change when a run continues.

    Attributes:
        races: 4x5 is five races of four agents, 4+1x5 is five races of four agents and one bot.
        tracks: tracks or splits to train on, such as train_only; driven in both directions.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        max_cycles: steps after which a race that started anywhere is cut short.
        snapshot_share: fraction of races in which a past self drives half of the agents' karts.
        pool_size: number of past selves to keep as opponents.
        init: weights to start from; empty starts from scratch.
        hold: minimum steps of a drift; a drift earns a boost after 11 steps.
        warm_up: kart-steps at the start that train only the value network; for runs with --init.
        decay_timesteps: learning rate and entropy coefficient decay as 1 / sqrt(1 + kart-steps /
            this); 0 keeps them constant.
    """

    learning_rate: float = 5e-4
    n_epochs: int = 4
    ent_coef: Coefficient = 0.003
    keep_every: int = 50_000
    checkpoint_every: int = 32
    races: str = "4x5"
    tracks: tuple[str, ...] = option(QUICK_TRACKS, flag="--track", metavar="TRACK")
    difficulty: Level = 3
    max_cycles: int = 250
    snapshot_share: Share = 0.5
    pool_size: int = 12
    init: str = ""
    hold: Natural = 11
    warm_up: Natural = 0
    decay_timesteps: Natural = 1_000_000


def selfplay_setup(arguments: SB3Arguments) -> PPOSetup:
    """Returns what a run learns.

    Raises:
        ConfigError: an argument is invalid.
    """
    lineup = parse_races([arguments.races])[0]
    if arguments.n_steps * lineup.learners * lineup.races < 2:
        raise ConfigError("n_steps is 1 in a race of one agent, expected 2 or more steps")
    options = {
        "num_kart": lineup.learners + lineup.bots,
        "agents": lineup.learners,
        "track": arguments.tracks,
        "reverse": None,
        "difficulty": arguments.difficulty,
        "start": "random",
        "max_cycles": arguments.max_cycles,
        "view": "racing",
        "reward": _REWARD,
    }
    hidden, init = arguments.hidden, arguments.init
    tracks = Matchmaker(PRIORITIZED, len(arguments.tracks))
    for name in arguments.tracks:
        tracks.add(name)
    return PPOSetup(
        groups=(ActorRaces(lineup.races, options, has_rivals=True),),
        make_network=partial(
            RacingNetwork, hidden, arguments.seed, INPUT_SIZE, hold=arguments.hold
        ),
        read_first=partial(racing_weights, init, hidden) if init else None,
        hold=arguments.hold,
        matchmaker=Matchmaker(PRIORITIZED, arguments.pool_size, arguments.snapshot_share),
        tracks=tracks,
    )


# ---------------------------------------------------------------------- the races


class SelfPlayRaces(RaceVecEnv):
    """Races in which past selves drive some of the agents' karts, through the action filter.

    A past self's slot is idle, so :class:`stkzoo.sb3.ActiveRolloutBuffer` leaves out its steps.

    Args:
        group: the races.
        hold: minimum steps of a drift.
        matchmaker: determines the opponents; updated with the results.
        tracks: determines the tracks of half of the races; updated with the paces on each track.
        past: folder of the past selves.

    Attributes:
        finishes: the races of the learner's karts that ended.
        rewards: the rewards of the learner's karts in each step.
        paces: their speeds over the mean speed of the game's AI in such races.
    """

    def __init__(
        self,
        group: ActorRaces,
        hold: int,
        matchmaker: Matchmaker,
        tracks: Matchmaker,
        past: Path,
    ) -> None:
        super().__init__(group.num_races, **group.options)
        num_grid = (group.num_races + 1) // 2
        lengths = [_GRID] * num_grid + [{}] * (group.num_races - num_grid)
        self._lengths, self._options = lengths, list(lengths)
        self.races.set_options(self._options)
        self.observation_space = spaces.Box(-np.inf, np.inf, (INPUT_SIZE,), np.float32)
        view = FilteredView(self.num_envs, hold)
        self._mirrored = MirroredRaces(self.races, view, MIRROR_SHARE)
        self._company, self._past = group.company, past
        self._matchmaker, self._tracks = matchmaker, tracks
        self._track_names = [""] * group.num_races
        self._seats = RivalSeats(group.num_races, group.num_agents)
        self._drivers: dict[str, MlpDriver] = {}
        self._random = np.random.default_rng()
        self._seen: FloatArray = np.zeros((0, INPUT_SIZE), np.float32)
        self._ai_speeds = np.ones((group.num_races, group.num_agents))
        self.finishes: list[KartRace] = []
        self.rewards: list[FloatArray] = []
        self.paces: list[FloatArray] = []

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seeds all random numbers from the next :meth:`reset` on."""
        self._random = np.random.default_rng(seed)
        return [seed] * self.num_envs

    def reset(self) -> FloatArray:
        """Starts new races; returns the observations of all slots."""
        for race in range(self.races.num_races):
            self._draw_track(race)  # the run that saved the checkpoint has drawn other ones
        self._seen, _ = self._mirrored.reset(seed=int(self._random.integers(2**31)))
        for race in range(self.races.num_races):
            self._begin_race(race)
        return self._seen

    def step_async(self, actions: npt.NDArray[Any]) -> None:
        """Starts a step with the learner's actions for its karts; past selves choose their own."""
        choices = np.array(actions)
        for name, rows in self._seats.rows_by_name().items():
            if name not in self._drivers:
                self._drivers[name] = load_driver(self._past / f"{name}.safetensors")
            choices[rows] = self._drivers[name].sample(self._seen[rows], self._random)
        self._learns = self.races.racing & self._seats.is_own.reshape(-1)
        self._mirrored.step_async(choices)

    def step_wait(
        self,
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Waits for the step and returns its results.

        A finish is a truncation, too: the road continues behind the line, and a kart does not
        observe its distance to the line. Otherwise, its value would drop unpredictably.
        """
        self._seen, rewards, finished, cut, infos = self._mirrored.step_wait()
        ended, learns, meters = finished | cut, self._learns, 10 * infos["reward/advance"]
        if ended.any():
            meters = np.where(ended, 10 * infos["final_info"]["reward/advance"], meters)
        self.rewards.append(rewards[learns])
        self.paces.append((meters / STEP / self._ai_speeds.reshape(-1))[learns])
        by_slot: list[dict[str, Any]] = [{} for _ in learns]
        for slot in np.flatnonzero(ended).tolist():
            if learns[slot]:
                last = {"terminal_observation": infos["final_obs"][slot]}
                by_slot[slot] = {**last, "TimeLimit.truncated": True}
            self._end(slot, infos["final_info"], is_finished=bool(finished[slot]))
        rewards = np.where(learns, rewards, 0.0).astype(np.float32)
        return self._seen, rewards, ended | ~learns, by_slot

    def _begin_race(self, race: int) -> None:
        """Draws the drivers of a race that begins, and the track of the next one."""
        env: Any = self.races.races[race]
        facts = env.race
        seconds = ai_time(facts.track, facts.reverse, facts.difficulty)
        self._ai_speeds[race] = env.track_map.length / seconds
        opponent = draw_opponent(self._matchmaker.odds(), self._random)
        self._seats.seat(race, opponent, self._random)
        self._track_names[race] = facts.track
        self._draw_track(race)

    def _draw_track(self, race: int) -> None:
        """Draws whether the next race is on a track where the learner is slow, or on any track."""
        if self._tracks.pool:
            name = draw_opponent(self._tracks.odds(), self._random)
            self._options[race] = self._lengths[race] | ({"track": name} if name else {})
            self.races.set_options(self._options)

    def _end(self, slot: int, last: Mapping[str, Any], *, is_finished: bool) -> None:
        """Records the end of a kart's race, and of the race if it was the last kart."""
        race, agent = divmod(slot, self.races.num_agents)
        position = int(last["position"][slot])
        if self._seats.is_own[race, agent]:
            meters = max(10 * float(last["episode/reward/advance"][slot]), 1.0)
            of_ai = STEP * int(last["episode"]["l"][slot]) * float(self._ai_speeds[race, agent])
            ratio = of_ai / meters if is_finished else None
            if track := self._tracks.pool.get(self._track_names[race]):
                track.update(min(meters / of_ai, 1.0))
            reward = float(last["episode"]["r"][slot])
            self.finishes.append(KartRace(self._company, reward, position, ratio))
        if self._seats.end(slot, position):
            beaten = self._seats.beaten(race)
            if beaten is not None:
                self._matchmaker.update(self._seats.names[race], beaten)
            self._begin_race(race)


# ---------------------------------------------------------------------- the run


class SB3Run(TrainingRun):
    """A run of Stable-Baselines3's PPO on the networks of the other programs.

    Args:
        folder: folder of the run.
        arguments: arguments of the run.

    Raises:
        ConfigError: an argument is invalid, or the folder contains another run or is used by
            another program.
    """

    arguments: SB3Arguments

    def __init__(self, folder: str | Path, arguments: SB3Arguments) -> None:
        super().__init__(folder, arguments, selfplay_setup(arguments))

    def begin_races(self) -> None:
        """See :class:`TrainingRun`."""
        self._model.set_env(self._races, force_reset=True)
        seeds = np.random.SeedSequence([self.arguments.seed, self.iteration])
        self._model.set_random_seed(int(seeds.generate_state(1)[0]))

    def iterate(self) -> dict[str, float]:
        """See :class:`TrainingRun`."""
        begin, races, buffer = time.perf_counter(), self._races, self._model.rollout_buffer
        self._set_rates()
        races.rewards.clear()
        races.paces.clear()
        self._model.learn(buffer.buffer_size * races.num_envs, reset_num_timesteps=False)
        rewards = np.concatenate(races.rewards)
        self.recent.extend(races.finishes)
        races.finishes.clear()
        self.iteration += 1
        self.kart_steps += len(rewards)
        values, returns = (a.reshape(-1)[buffer.active] for a in (buffer.values, buffer.returns))
        logged = self._model.logger.name_to_value
        line = {
            "iteration": self.iteration,
            "kart_steps": self.kart_steps,
            "rivals": len(self.matchmaker.pool),
            "reward": float(rewards.mean()),
            "pace": float(np.concatenate(races.paces).mean()),
            **race_figures(self.recent),
            **self.matchmaker.figures(),
            "kl": float(logged["train/approx_kl"]),
            "entropy": -float(logged["train/entropy_loss"]),
            "value_loss": float(logged["train/value_loss"]),
            "learning_rate": float(logged["train/learning_rate"]),
            "explained": float(explained_variance(values, returns)),
            "kart_steps_per_s": len(rewards) / (time.perf_counter() - begin),
        }
        return {name: round(value, 6) for name, value in line.items()}

    def _make_races(self) -> Callable[[], None]:
        setup, arguments = self._setup, self.arguments
        Distribution.set_default_validate_args(False)  # saves a fifth of the learning time
        self._races = SelfPlayRaces(
            setup.groups[0], arguments.hold, self.matchmaker, setup.tracks, self.folder
        )
        with warnings.catch_warnings():
            # Batches may differ in size: the buffer leaves out idle slots.
            warnings.filterwarnings("ignore", "You have specified a mini-batch size")
            self._model: Any = PPO(
                "MlpPolicy",
                self._races,
                rollout_buffer_class=ActiveRolloutBuffer,
                policy_kwargs={"net_arch": list(arguments.hidden)},
                device="cpu",
                **{name: getattr(arguments, name) for name in _PPO_NAMES},
            )
        self._model.set_logger(Logger(None, []))
        policy, network = self._model.policy, self.network
        layers = policy.mlp_extractor
        layers.policy_net, policy.action_net = network.policy[:-1], network.policy[-1]
        layers.value_net, policy.value_net = network.value[:-1], network.value[-1]
        policy.optimizer = network.optimizer
        return self._races.close

    def _set_rates(self) -> None:
        """Decays the rates, and freezes the policy during the warm-up of the value network."""
        arguments = self.arguments
        passed = self.kart_steps / arguments.decay_timesteps if arguments.decay_timesteps else 0.0
        share = (1.0 + passed) ** -0.5
        self._model.lr_schedule = lambda _: share * arguments.learning_rate
        self._model.ent_coef = share * arguments.ent_coef
        self.network.policy.requires_grad_(self.kart_steps >= arguments.warm_up)


# ---------------------------------------------------------------------- the command


@dataclass(frozen=True, slots=True)
class SB3Options(ScriptOptions):
    """Options of the command.

    Attributes:
        total_timesteps: total kart-steps.
    """

    total_timesteps: int = 10_000_000


def train(options: SB3Options, arguments: SB3Arguments) -> None:
    """Starts or continues a run, and writes its agent at the end.

    Raises:
        ConfigError: see :class:`SB3Run`.
    """
    with closing(SB3Run(options.output, arguments)) as run:
        run.learn(options.total_timesteps, _SHOWN)
        policy = run.save_policy(run.folder / "policy.safetensors")
        agent = export_policy(policy, f"selfplay_{run.kart_steps}", run.folder / "agent")
    print(f"stkzoo race {agent} ai ai random --track {arguments.tracks[0]}")


def main(words: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    remedy = "the same command continues from the last checkpoint"
    return run_command("sb3.selfplay", __doc__, train, (SB3Options, SB3Arguments), words, remedy)


if __name__ == "__main__":
    sys.exit(main())
