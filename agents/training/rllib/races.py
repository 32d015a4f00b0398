"""Arguments and races of RLlib's env runners, and the sampler that drives the races.

Needs no Ray.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from stkzoo import RaceVectorEnv
from stkzoo._arguments import option
from stkzoo._schema import Level, Share
from stkzoo.agents.pretrained.mlp import MlpDriver
from stkzoo.engine.assets import cache_folder, find_assets, install
from stkzoo.errors import AssetError, ConfigError
from stkzoo.wrappers.racing import CHOICES

from ..common.arguments import Coefficient, Natural, PPOArguments, RunArguments
from ..ppo.rollouts import racing_shape, sample

FloatArray = npt.NDArray[np.float32]
IntArray = npt.NDArray[np.intp]

#: Name of the module that learns.
MAIN = "main"
#: Key of the arguments in RLlib's configuration of the environment.
ARGUMENTS = "arguments"
#: Name of the headless pack in the folder that Ray copies to every node.
PACK = "stk.tar.xz"
#: Stable-Baselines3's names of the layers of RLlib's module.
_LAYERS = {
    "encoder.actor_encoder.net.mlp.": "mlp_extractor.policy_net.",
    "encoder.critic_encoder.net.mlp.": "mlp_extractor.value_net.",
    "pi.net.mlp.0.": "action_net.",
    "vf.net.mlp.0.": "value_net.",
}


@dataclass(frozen=True, slots=True)
class RLlibArguments(PPOArguments):
    """Arguments of a run.

    Attributes:
        iterations: total iterations.
        env_runners: processes that run races; 0 runs them in the main process.
        envs_per_runner: parallel races in each env runner.
        address: address of a Ray cluster, or auto; empty starts Ray on this machine.
        tracks: names of tracks, or train, train_only, validation, test or all.
        difficulty: skill of the game's AI and speed of all karts, 0 to 3.
        learners: karts of the policy that learns.
        frozen: karts of its past selves.
        bots: karts of the game's AI.
        slots: number of past selves to keep.
        snapshot_every: iterations between two past selves.
        max_cycles: steps after which a race is truncated.
        train_batch_size: kart-steps of the learner's karts per iteration.
        checkpoint_every: iterations between two checkpoints.
    """

    n_epochs: int = 6
    gae_lambda: Share = 0.9
    ent_coef: Coefficient = 0.003
    iterations: int = 200
    env_runners: Natural = 2
    envs_per_runner: int = 1
    address: str = ""
    tracks: tuple[str, ...] = option(("train",), flag="--track", metavar="TRACK")
    difficulty: Level = 2
    learners: int = 2
    frozen: Natural = 2
    bots: Natural = 1
    slots: int = 5
    snapshot_every: int = 10
    max_cycles: int = 1500
    train_batch_size: int = 8000
    checkpoint_every: int = 5

    def __post_init__(self) -> None:
        RunArguments.__post_init__(self)
        if self.learners + self.frozen + self.bots > 20:
            raise ConfigError("more than 20 karts in a race; give fewer learners, frozen or bots")
        if self.batch_size > self.train_batch_size:
            raise ConfigError(
                f"batch_size is {self.batch_size}, expected at most {self.train_batch_size}, the "
                "kart-steps of an iteration; give a smaller --batch-size or a larger "
                "--train-batch-size"
            )

    @property
    def modules(self) -> list[str]:
        """Returns the names of all modules; the first one learns."""
        return [MAIN, *(self.slot(number) for number in range(self.slots if self.frozen else 0))]

    def slot(self, number: int) -> str:
        """Returns the module of a snapshot; a new one replaces the oldest."""
        return f"past_{number % self.slots}"

    def modules_of(self, race: int) -> list[str]:
        """Returns the module that drives each agent's kart; the learner's karts come first.

        Args:
            race: any number, which selects the past selves.
        """
        past = [self.slot(race + number) for number in range(self.frozen)]
        return [MAIN] * self.learners + past


def ensure_assets(archive: str | Path = PACK) -> None:
    """Installs the headless pack if the game's data is missing.

    Args:
        archive: the pack, as `stkzoo assets pack --output` writes it.

    Raises:
        AssetError: the data and the pack are missing.
    """
    from filelock import FileLock

    cache_folder().mkdir(parents=True, exist_ok=True)
    with FileLock(cache_folder() / "rllib.lock"):  # one process per node at a time
        try:
            find_assets()
        except AssetError:
            if not Path(archive).is_file():
                raise
            install(archive=Path(archive))


def make_races(arguments: RLlibArguments) -> RaceVectorEnv:
    """Returns the races of one env runner."""
    agents, tracks = arguments.learners + arguments.frozen, arguments.tracks
    return RaceVectorEnv(
        arguments.envs_per_runner,
        agents=agents,
        num_kart=agents + arguments.bots,
        track=tracks[0] if len(tracks) == 1 else tracks,
        difficulty=arguments.difficulty,
        view="racing",
        max_cycles=arguments.max_cycles,
    )


@dataclass(frozen=True, slots=True)
class Fragment:
    """Consecutive steps of one kart in one race.

    Attributes:
        slot: number of the kart among those of all races.
        observations: ``(T + 1, F)``; the last one follows the last step.
        actions: ``(T, 5)``.
        rewards: ``(T,)``.
        logits: ``(T, 31)`` of the policy that acted.
        log_probabilities: ``(T,)`` of the actions.
        is_terminated: whether the kart finished in the last step.
        is_truncated: whether the race was truncated after the last step.
    """

    slot: int
    observations: FloatArray
    actions: IntArray
    rewards: FloatArray
    logits: FloatArray
    log_probabilities: FloatArray
    is_terminated: bool
    is_truncated: bool

    def __len__(self) -> int:
        return len(self.rewards)


class RaceSampler:
    """Drives all races of an env runner at once: one network call for each module and step.

    Args:
        races: the races, whose agents are the learner's karts and its past selves.
        arguments: arguments of the run.
        seed: seed of the races and of the actions; ``None`` is random.

    Attributes:
        returns: returns of the learner's karts whose races ended since the caller last emptied the
            list.
    """

    def __init__(
        self,
        races: RaceVectorEnv,
        arguments: RLlibArguments,
        seed: int | Sequence[int] | None = None,
    ) -> None:
        self.returns: list[float] = []
        self._races, self._arguments = races, arguments
        self._random = np.random.default_rng(seed)
        self._networks: dict[str, MlpDriver] = {}
        self._learns = np.arange(races.num_envs) % races.num_agents < arguments.learners
        self._modules = np.empty((races.num_races, races.num_agents), object)
        self._observations: Any = None

    def load(self, networks: Mapping[str, MlpDriver]) -> None:
        """Replaces the networks of some modules, from the next step on."""
        self._networks.update(networks)

    def sample(self, kart_steps: int) -> list[Fragment]:
        """Drives until the learner's karts have made a number of steps; returns these steps.

        Episodes that continue are cut; the next call returns the rest of them.

        Args:
            kart_steps: minimum number of steps of the learner's karts, in total.
        """
        if self._observations is None:
            self._observations, _ = self._races.reset(seed=int(self._random.integers(2**31)))
            self._draw_past_selves(range(self._races.num_races))
        steps: list[dict[str, npt.NDArray[Any]]] = []
        count = 0
        while count < kart_steps:
            steps.append(self._step())
            count += np.count_nonzero(steps[-1]["active"] & self._learns)
        return _fragments(steps, np.flatnonzero(self._learns))

    def _step(self) -> dict[str, npt.NDArray[Any]]:
        """Makes one step of all races, and returns its arrays; see :func:`_fragments`."""
        seen, racing = self._observations, self._races.racing
        logits = self._logits(racing)
        shape = racing_shape()
        actions, log_probabilities = sample(logits, self._random, shape.heads, shape.columns)
        self._races.step_async(actions)
        self._observations, rewards, terminations, truncations, infos = self._races.step_wait()
        ended, after = terminations | truncations, self._observations.copy()
        if ended.any():
            after[ended] = np.stack(infos["final_obs"][ended])
            self.returns += infos["final_info"]["episode"]["r"][ended & self._learns].tolist()
            is_left = (racing & ~ended).reshape(self._modules.shape)
            self._draw_past_selves(np.flatnonzero(~is_left.any(axis=1)).tolist())
        return {
            "active": infos["active"],
            "observations": seen,
            "after": after,
            "actions": actions,
            "rewards": rewards.astype(np.float32),
            "logits": logits,
            "log_probabilities": log_probabilities,
            "is_terminated": terminations,
            "is_truncated": truncations,
        }

    def _logits(self, racing: npt.NDArray[np.bool_]) -> FloatArray:
        """Returns the logits of all karts; zeros for idle ones."""
        logits = np.zeros((len(racing), sum(CHOICES)), np.float32)
        for module, network in self._networks.items():
            rows = np.flatnonzero((self._modules.ravel() == module) & racing)
            if len(rows):
                logits[rows] = network.logits(self._observations[rows])
        return logits

    def _draw_past_selves(self, races: Sequence[int]) -> None:
        """Draws the drivers of races that have just begun."""
        for race in races:
            number = int(self._random.integers(self._arguments.slots))
            self._modules[race] = self._arguments.modules_of(number)


def _fragments(steps: Sequence[Mapping[str, npt.NDArray[Any]]], slots: IntArray) -> list[Fragment]:
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
        driven = np.flatnonzero(active[:, slot])
        for part in np.split(driven, np.flatnonzero(ended[driven, slot]) + 1):
            if len(part):
                values: dict[str, Any] = {name: a[part, slot] for name, a in arrays.items()}
                last = after[part[-1], slot]
                values["observations"] = np.concatenate([values["observations"], last[None]])
                for flag in ("is_terminated", "is_truncated"):
                    values[flag] = bool(values[flag][-1])
                fragments.append(Fragment(slot, **values))
    return fragments


def sb3_names(state: Mapping[str, npt.NDArray[np.float32]]) -> dict[str, npt.NDArray[np.float32]]:
    """Returns the weights of RLlib's module under Stable-Baselines3's names."""
    return {
        layer + name.removeprefix(prefix): array
        for name, array in state.items()
        for prefix, layer in _LAYERS.items()
        if name.startswith(prefix)
    }
