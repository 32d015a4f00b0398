"""RLlib's env runner and callbacks for ``rllib.selfplay``. Needs Ray."""

from __future__ import annotations

import math
import uuid
from collections import deque
from collections.abc import Mapping
from typing import Any

from gymnasium import spaces
from ray.rllib.callbacks.callbacks import RLlibCallback
from ray.rllib.core import COMPONENT_LEARNER, COMPONENT_RL_MODULE
from ray.rllib.core.columns import Columns
from ray.rllib.env import INPUT_ENV_SINGLE_SPACES, INPUT_ENV_SPACES
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.utils.metrics import (
    ENV_RUNNER_RESULTS,
    EPISODE_RETURN_MEAN,
    NUM_ENV_STEPS_SAMPLED,
    NUM_ENV_STEPS_SAMPLED_LIFETIME,
    NUM_EPISODES,
    NUM_MODULE_STEPS_SAMPLED,
    NUM_MODULE_STEPS_SAMPLED_LIFETIME,
    WEIGHTS_SEQ_NO,
)

from stkzoo.agents.pretrained.mlp import MlpDriver

from .races import ARGUMENTS, MAIN, RLlibArguments, make_races
from .sampler import Fragment, RaceSampler, SampledRace, sb3_names

#: Names of the logged figures.
RETURN, WIN_SHARE, RACES, RESTARTED = "return", "win_share", "races", "restarted"
#: Sums over the races of an iteration: of their returns, and of their shares of duels won.
RETURNS, WIN_SHARES = "returns", "win_shares"
#: Number of races in the means of the log.
_RECENT = 50


class RaceEnvRunner(MultiAgentEnvRunner):
    """Samples all races of the process as one batch, and returns the learner's karts only.

    RLlib's own runner makes a dict for each agent and step, and calls torch. This one holds the
    same modules, weights and connectors, so RLlib synchronizes, saves and restores it as usual, but
    :class:`~stkzoo.agents.training.rllib.sampler.RaceSampler` drives. A step of an env runner, in
    RLlib's figures and in ``train_batch_size``, is a step of one of the learner's karts.
    """

    env: Any
    _has_new_weights = True

    def make_env(self) -> None:
        """Makes the races; RLlib calls it in the constructor."""
        if self.env is not None:
            self.env.close()
        arguments: RLlibArguments = self.config.env_config[ARGUMENTS]
        self.env = make_races(arguments)
        self.num_envs = self.env.num_envs
        self._sampler: RaceSampler | None = None
        self._has_new_weights = True

    def get_spaces(self) -> dict[str, Any]:
        """Returns the spaces of all modules, which are the same."""
        if self.env is None:
            return dict(self.spaces)
        one = self.env.single_observation_space, self.env.single_action_space
        names = self.config.env_config[ARGUMENTS].modules
        of_all = tuple(spaces.Dict(dict.fromkeys(names, space)) for space in one)
        return {
            INPUT_ENV_SPACES: of_all,
            INPUT_ENV_SINGLE_SPACES: of_all,
            **dict.fromkeys(names, one),
        }

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Restores a state, or a part of it: usually new weights of some modules."""
        super().set_state(state)
        self._has_new_weights |= COMPONENT_RL_MODULE in state

    def sample(self, *, num_timesteps: int | None = None, **_: Any) -> list[SingleAgentEpisode]:
        """Samples steps of the learner's karts.

        Args:
            num_timesteps: minimum number of steps; ``None`` is this env runner's share of the
                training batch.

        Returns:
            Chunks of episodes. A chunk without a flag continues in the next call.
        """
        if num_timesteps is None:
            runners = max(self.config.num_env_runners, 1)
            num_timesteps = math.ceil(self.config.total_train_batch_size / runners)
        if self._sampler is None:
            self._sampler = self._new_sampler()
        if self._has_new_weights:
            self._sampler.load(_networks(self.module))
            self._has_new_weights = False
        self.metrics.log_value(WEIGHTS_SEQ_NO, self._weights_seq_no, window=1)
        fragments = self._sampler.sample(num_timesteps)
        self._log_steps(sum(map(len, fragments)))
        for result in self._sampler.results:
            self._log_race(result)
        self._sampler.results.clear()
        return [_episode(fragment) for fragment in fragments]

    def _new_sampler(self) -> RaceSampler:
        """Returns a sampler whose seed no earlier env runner had: it depends on the weights."""
        seed = [self.config.seed, self.worker_index or 0, self._weights_seq_no]
        return RaceSampler(self.env, self.config.env_config[ARGUMENTS], seed)

    def _log_steps(self, steps: int) -> None:
        for key in (NUM_ENV_STEPS_SAMPLED, (NUM_MODULE_STEPS_SAMPLED, MAIN)):
            self.metrics.log_value(key, steps, reduce="sum")
        for key in (NUM_ENV_STEPS_SAMPLED_LIFETIME, (NUM_MODULE_STEPS_SAMPLED_LIFETIME, MAIN)):
            self.metrics.log_value(key, steps, reduce="lifetime_sum")

    def _log_race(self, result: SampledRace) -> None:
        self.metrics.log_value(RACES, 1, reduce="lifetime_sum")
        self.metrics.log_value(EPISODE_RETURN_MEAN, result.reward, reduce="mean", window=_RECENT)
        sums = {NUM_EPISODES: 1, RETURNS: result.reward, WIN_SHARES: result.win_share or 0.0}
        for key, value in sums.items():
            self.metrics.log_value(key, value, reduce="sum")


def _networks(module: Any) -> dict[str, MlpDriver]:
    """Returns the policies of a ``MultiRLModule`` as networks of the kernel."""
    return {
        name: MlpDriver(
            sb3_names({key: value.cpu().numpy() for key, value in own.state_dict().items()}), name
        )
        for name, own in module.items()
    }


def _episode(fragment: Fragment) -> SingleAgentEpisode:
    """Converts a fragment to the form that RLlib's learner expects.

    A batch may contain several chunks of one kart, and RLlib joins chunks with the same ids of
    episode, agent and module. Therefore, each chunk has its own episode id.
    """
    return SingleAgentEpisode(
        multi_agent_episode_id=uuid.uuid4().hex,
        agent_id=f"slot_{fragment.slot}",
        module_id=MAIN,
        observations=fragment.observations,
        infos=[{}] * (len(fragment) + 1),
        actions=fragment.actions,
        rewards=fragment.rewards,
        extra_model_outputs={
            Columns.ACTION_LOGP: fragment.log_probabilities,
            Columns.ACTION_DIST_INPUTS: fragment.logits,
        },
        terminated=fragment.is_terminated,
        truncated=fragment.is_truncated,
        t_started=fragment.begin,
        len_lookback_buffer=0,
    )


class SelfPlay(RLlibCallback):
    """Logs results, and saves a frozen snapshot of the learner when it wins often enough.

    Args:
        arguments: arguments of the run.
    """

    def __init__(self, arguments: RLlibArguments) -> None:
        super().__init__()
        self._arguments = arguments
        self.promotions = 0
        self.restarts = 0
        self._races_then = 0.0
        #: Numbers of races, sums of returns and of shares won of the latest iterations. RLlib's own
        #: means cover one iteration, and count the mean of each env runner once.
        self._recent: deque[tuple[float, ...]] = deque()

    def remember(self, promotions: int, races: float) -> None:
        """Restores the progress of a run; its last snapshot was made after ``races`` races."""
        self.promotions, self._races_then = promotions, races

    def on_algorithm_init(self, *, algorithm: Any, **_: Any) -> None:
        """Initializes all past selves with the learner's weights."""
        for module in self._arguments.modules[1:]:
            copy_main(algorithm, module)

    def on_train_result(self, *, algorithm: Any, result: dict[str, Any], **_: Any) -> None:
        """Promotes the learner if it wins often enough."""
        figures: Mapping[str, float] = result.get(ENV_RUNNER_RESULTS, {})
        races = float(figures.get(RACES, 0.0))
        result[RETURN], wins = self._means_with(figures)
        arguments = self._arguments
        is_due = races - self._races_then >= arguments.least_races
        if arguments.frozen and is_due and wins >= arguments.promote_at:
            copy_main(algorithm, arguments.slot(self.promotions))
            self.promotions += 1
            self._races_then = races
            self._recent.clear()
        result[WIN_SHARE] = wins if arguments.frozen else math.nan
        result["promotions"] = self.promotions
        result[RESTARTED] = self.restarts

    def _means_with(self, figures: Mapping[str, float]) -> tuple[float, float]:
        """Adds an iteration; returns the mean return and share won of the latest races, or NaN."""
        sums = [figures.get(name, 0.0) for name in (NUM_EPISODES, RETURNS, WIN_SHARES)]
        self._recent.append(tuple(0.0 if math.isnan(value) else value for value in sums))
        while sum(races for races, *_ in self._recent) - self._recent[0][0] >= _RECENT:
            self._recent.popleft()
        races, returns, win_shares = map(sum, zip(*self._recent, strict=True))
        return (returns / races, win_shares / races) if races else (math.nan, math.nan)

    def on_env_runners_recreated(self, *, env_runner_indices: list[int], **_: Any) -> None:
        """Counts the restarted env runners."""
        self.restarts += len(env_runner_indices)


def copy_main(algorithm: Any, module: str) -> None:
    """Copies the learner's weights to a frozen module, on all learners and env runners."""

    def copy(learner: Any) -> None:
        learner.module[module].load_state_dict(learner.module[MAIN].state_dict())

    algorithm.learner_group.foreach_learner(copy)
    path = f"{COMPONENT_LEARNER}/{COMPONENT_RL_MODULE}/{module}"
    state = algorithm.learner_group.get_state(components=path, inference_only=True)
    weights = {COMPONENT_RL_MODULE: state[COMPONENT_LEARNER][COMPONENT_RL_MODULE]}
    # Env runners skip weights with a number that they already have; these weights have none.
    algorithm.env_runner_group.foreach_env_runner(lambda runner: runner.set_state(weights))
