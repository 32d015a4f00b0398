"""RLlib's env runner for ``rllib.selfplay``. Needs Ray."""

from __future__ import annotations

import math
import uuid
from collections.abc import Mapping
from typing import Any

from gymnasium import spaces
from ray.rllib.core import COMPONENT_LEARNER, COMPONENT_RL_MODULE
from ray.rllib.core.columns import Columns
from ray.rllib.env import INPUT_ENV_SINGLE_SPACES, INPUT_ENV_SPACES
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner
from ray.rllib.env.single_agent_episode import SingleAgentEpisode
from ray.rllib.utils.metrics import (
    EPISODE_RETURN_MEAN,
    NUM_ENV_STEPS_SAMPLED,
    NUM_ENV_STEPS_SAMPLED_LIFETIME,
    NUM_EPISODES_LIFETIME,
    NUM_MODULE_STEPS_SAMPLED,
    NUM_MODULE_STEPS_SAMPLED_LIFETIME,
    WEIGHTS_SEQ_NO,
)

from stkzoo.agents.pretrained.mlp import MlpDriver

from .races import (
    ARGUMENTS,
    MAIN,
    Fragment,
    RaceSampler,
    RLlibArguments,
    ensure_assets,
    make_races,
    sb3_names,
)

#: Number of episodes in the mean return.
_RECENT = 50


class RaceEnvRunner(MultiAgentEnvRunner):
    """Samples all races of the process as one batch, and returns the learner's karts only.

    RLlib's own runner makes a dict for each agent and step, and calls torch. This one holds the
    same modules, weights and connectors, so RLlib synchronizes, saves and restores it as usual, but
    :class:`~stkzoo.agents.training.rllib.races.RaceSampler` drives. A step of an env runner, in
    RLlib's figures and in ``train_batch_size``, is a step of one of the learner's karts; an episode
    is the race of one of these karts.
    """

    env: Any
    _has_new_weights = True

    def make_env(self) -> None:
        """Makes the races; RLlib calls it in the constructor."""
        if self.env is not None:
            self.env.close()
        arguments: RLlibArguments = self.config.env_config[ARGUMENTS]
        ensure_assets()
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
        if self._sampler is None:  # the weights' number gives each restarted env runner a new seed
            seed = [self.config.seed, self.worker_index or 0, self._weights_seq_no]
            self._sampler = RaceSampler(self.env, self.config.env_config[ARGUMENTS], seed)
        if self._has_new_weights:
            self._sampler.load(_networks(self.module))
            self._has_new_weights = False
        fragments = self._sampler.sample(num_timesteps)
        self._log(sum(map(len, fragments)), self._sampler.returns)
        self._sampler.returns.clear()
        return [_episode(fragment) for fragment in fragments]

    def _log(self, steps: int, returns: list[float]) -> None:
        log = self.metrics.log_value
        log(WEIGHTS_SEQ_NO, self._weights_seq_no, window=1)
        for key in (NUM_ENV_STEPS_SAMPLED, (NUM_MODULE_STEPS_SAMPLED, MAIN)):
            log(key, steps, reduce="sum")
        for key in (NUM_ENV_STEPS_SAMPLED_LIFETIME, (NUM_MODULE_STEPS_SAMPLED_LIFETIME, MAIN)):
            log(key, steps, reduce="lifetime_sum")
        log(NUM_EPISODES_LIFETIME, len(returns), reduce="lifetime_sum")
        for value in returns:
            log(EPISODE_RETURN_MEAN, value, reduce="mean", window=_RECENT)


def _networks(module: Any) -> dict[str, MlpDriver]:
    """Returns the policies of a ``MultiRLModule`` as networks of the kernel."""
    return {
        name: MlpDriver(sb3_names({k: v.cpu().numpy() for k, v in part.state_dict().items()}), name)
        for name, part in module.items()
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
        len_lookback_buffer=0,
    )


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
