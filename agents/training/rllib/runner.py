"""RLlib's env runner for ``rllib.selfplay``. Needs Ray."""

from __future__ import annotations

import math
import uuid
from collections.abc import Mapping
from typing import Any

from gymnasium import spaces
from ray.rllib.core import COMPONENT_RL_MODULE
from ray.rllib.core.columns import Columns
from ray.rllib.env import INPUT_ENV_SINGLE_SPACES, INPUT_ENV_SPACES
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.utils.metrics import (
    EPISODE_LEN_MEAN,
    EPISODE_MODULE_RETURN_MEAN,
    EPISODE_RETURN_MEAN,
    NUM_ENV_STEPS_SAMPLED,
    NUM_ENV_STEPS_SAMPLED_LIFETIME,
    NUM_EPISODES,
    NUM_EPISODES_LIFETIME,
    NUM_MODULE_STEPS_SAMPLED,
    NUM_MODULE_STEPS_SAMPLED_LIFETIME,
    SAMPLE_TIMER,
    WEIGHTS_SEQ_NO,
)

from stkzoo.agents.pretrained.mlp import MlpDriver

from .callbacks import RACES, RETURNS, WIN_SHARES
from .races import ARGUMENTS, MAIN, RLlibArguments, make_races
from .sampler import Fragment, RaceSampler, SampledRace, sb3_names

_WINDOW = 50


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
        with self.metrics.log_time(SAMPLE_TIMER):
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
        self.metrics.log_value(NUM_ENV_STEPS_SAMPLED, steps, reduce="sum")
        self.metrics.log_value((NUM_MODULE_STEPS_SAMPLED, MAIN), steps, reduce="sum")
        self.metrics.log_value(
            NUM_ENV_STEPS_SAMPLED_LIFETIME, steps, reduce="lifetime_sum", with_throughput=True
        )
        key = NUM_MODULE_STEPS_SAMPLED_LIFETIME, MAIN
        self.metrics.log_value(key, steps, reduce="lifetime_sum")

    def _log_race(self, result: SampledRace) -> None:
        self.metrics.log_value(NUM_EPISODES, 1, reduce="sum")
        self.metrics.log_value(RETURNS, result.reward, reduce="sum")
        self.metrics.log_value(WIN_SHARES, result.win_share or 0.0, reduce="sum")
        for name in (NUM_EPISODES_LIFETIME, RACES):
            self.metrics.log_value(name, 1, reduce="lifetime_sum")
        for key, value in {
            EPISODE_RETURN_MEAN: result.reward,
            (EPISODE_MODULE_RETURN_MEAN, MAIN): result.reward,
            EPISODE_LEN_MEAN: result.num_steps,
        }.items():
            self.metrics.log_value(key, value, reduce="mean", window=_WINDOW)


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
